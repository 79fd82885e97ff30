"""A case carried out: a `Study` with its parts, the run folder, and the work of every command.

`commands` has a function for each command. A domain gives a `kind.Kind` and a `study.Study`;
`chapter.Chapter` is one question to a run, and `carry_out` does the parts, resumes and reports.
"""
