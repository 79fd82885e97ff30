"""Runs a case: a `Study` with its parts, the run folder, and the functions of all commands.

`commands` has a function for each command. A domain provides a `kind.Kind` and a `study.Study`;
`chapter.Chapter` is one analysis of a run, and `carry_out` computes the parts, resumes and reports.
"""
