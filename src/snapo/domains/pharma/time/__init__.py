"""A unit over its time: profiles, meshes, integration."""
