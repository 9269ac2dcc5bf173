"""Live pictures of a scene, in a page of the browser or in a notebook."""
