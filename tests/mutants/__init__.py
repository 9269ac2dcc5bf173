"""Mutation tests: small faults that are planted in the code one at a time, each of which a test must notice."""
