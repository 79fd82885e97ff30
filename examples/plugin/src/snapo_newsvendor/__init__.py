"""The domain: light, so that `snapo new` answers at once; the rest is imported when needed."""

from importlib.resources import files


class Newsvendor:
    """A shop that orders every day before it knows the demand."""

    kind = "newsvendor"
    words = "orders for a shop with uncertain demand"

    @property
    def templates(self):
        return {"shop": files(__name__) / "template"}

    def read(self, file, data):
        from .study import read_case

        return read_case(file, data)

    def check(self, case):
        from .study import lines

        return lines(case)

    def study(self, case, options):
        from .study import study

        return study(case, options)

    def report(self):
        from .study import REPORT

        return REPORT

    def bench(self, engine, tell):
        from snapo.case.error import CaseError

        raise CaseError("KIND", "", self.kind, "this kind has nothing to time")


DOMAIN = Newsvendor()
