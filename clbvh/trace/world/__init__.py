"""What is traced: shapes, instances, and their arrays."""
