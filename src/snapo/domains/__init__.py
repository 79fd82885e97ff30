"""The kinds of cases that come with snapo: a package each, and none imports another.

Each is a `Kind` or a `Domain` of `snapo.study`, named in the entry points of `pyproject.toml`, by
which the commands find it, like the kinds of other packages.
"""
