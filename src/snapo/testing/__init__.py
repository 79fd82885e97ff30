"""For the tests of domains, ours and anyone's: the same mistakes, bumps and small runs for all.

- `mistakes`: every key and every column of a case spoilt in turn; a reader has to refuse them.
- `derivatives`: the adjoint of a problem against differences on the same paths.
- `miniature`: a case made small, its study carried out, and one run shared by many tests.

Nothing here needs a test framework: functions return complaints, and a test asserts that there
are none.
"""
