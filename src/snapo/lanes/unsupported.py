"""The reason why something cannot be compiled."""


class Unsupported(Exception):
    """A thing that cannot be compiled, with the primitive and the line of user code."""


# An error while an operation is emitted is a reason to take another engine, no accident.
ACCIDENTS = (LookupError, AssertionError, TypeError, ValueError, NotImplementedError)
