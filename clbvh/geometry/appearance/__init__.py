"""The looks of shapes: normals, texture coordinates, colours, materials and textures. Knows nothing of files."""
