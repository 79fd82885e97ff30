"""A unit over time: profiles, meshes, integration.

`integrate.integrate` solves the `dynamics.Dynamics` of a unit: with explicit steps on a mesh whose
points include the kinks, with implicit steps, or with error control.
"""
