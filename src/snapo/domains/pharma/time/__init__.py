"""A unit over its time: profiles, meshes, integration.

`integrate.integrate` solves the `dynamics.Dynamics` of a unit: explicit steps on a mesh that is
broken at kinks, held stiff steps, or error control.
"""
