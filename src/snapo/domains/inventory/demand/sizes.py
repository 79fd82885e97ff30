"""How large demand may be in a case."""

from typing import Annotated

from pydantic import Field

LARGEST = 1000.0  # of a demand in whole units: each is told apart
MEANS = f"a number above 0, at most {LARGEST:g}: where demand is larger, count it in boxes"
MeanSize = Annotated[float, Field(gt=0, le=LARGEST)]
