"""Property tests draw the same examples every time: a red test is then never a matter of luck."""

from hypothesis import settings

settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")
