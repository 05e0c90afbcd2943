"""Maps of a workspace: which orientations an arm reaches at every position of a set.

`ikjax.sweep` makes a `ReachMap`; here are the sets that it sweeps and the user's own statistics.
"""

from ikjax.maps.custom import Measure as Measure
from ikjax.maps.custom import Near as Near
from ikjax.maps.reach_map import compare as compare
from ikjax.maps.sets.hopf import Hopf as Hopf
from ikjax.maps.sets.hopf import hopf as hopf
from ikjax.maps.sets.orientations import Cone as Cone
from ikjax.maps.sets.orientations import Even as Even
from ikjax.maps.sets.orientations import cone as cone
from ikjax.maps.sets.orientations import even_rotations as even_rotations
from ikjax.maps.sets.positions import Grid as Grid
from ikjax.maps.sets.positions import Shell as Shell
from ikjax.maps.sets.positions import around as around
from ikjax.maps.sets.positions import grid as grid
from ikjax.maps.sets.positions import shell as shell
from ikjax.maps.sets.surface import Surface as Surface
from ikjax.maps.sets.surface import surface as surface
