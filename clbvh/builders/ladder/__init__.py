"""The builders of the report, variant by variant, to measure what each of its ideas bought."""
