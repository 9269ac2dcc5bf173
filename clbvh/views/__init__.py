"""What a picture is to look like, and from where: settings, cameras, cuts, environments; no device."""
