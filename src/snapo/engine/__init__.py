"""Engines: rollouts and their adjoints. `xla` always works; `native` is the fast one on CPUs."""

from .base import TRAJECTORY as TRAJECTORY
from .base import Adjoint as Adjoint
from .base import BoundEngine as BoundEngine
from .base import Clip as Clip
from .base import Engine as Engine
from .base import Rollout as Rollout
from .base import Window as Window
from .choose import EngineName as EngineName
from .choose import Engines as Engines
from .choose import choose as choose
from .native import Native as Native
from .native import Unsupported as Unsupported
from .workers import WorkerPool as WorkerPool
from .workers import Workers as Workers
from .xla import Xla as Xla
