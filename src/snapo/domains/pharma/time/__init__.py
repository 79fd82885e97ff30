"""A unit over time: profiles, meshes, integration.

`integrate.integrate` solves the `dynamics.Dynamics` of a unit: with explicit steps on a mesh that
has the kinks among its points, with implicit steps, or with error control.
"""
