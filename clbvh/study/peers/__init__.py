"""Other engines, each in a process of its own, so that no thread pool disturbs another."""
