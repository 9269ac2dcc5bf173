"""Images for programs: what each pixel sees, as arrays and as files."""
