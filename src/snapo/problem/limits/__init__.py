"""Limits that hold on average, or with a probability."""

from .limit import AtLeast as AtLeast
from .limit import AtMost as AtMost
from .limit import Limit as Limit
from .limit import priced as priced
