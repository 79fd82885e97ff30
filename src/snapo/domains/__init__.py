"""The kinds of cases that come with snapo: one package each; none of them imports another.

Each is a `Kind` or a `Domain` of `snapo.study`, listed in the entry points of `pyproject.toml`,
where the commands find it, as for kinds of other packages.
"""
