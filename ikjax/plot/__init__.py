"""Pictures: workspaces in slices, solids, discs and points, two of them compared, branches, the arm.

Needs matplotlib (`pip install ikjax[viz]`), which is imported at the first
picture. A figure is left open for `plt.show()`, unless it is given a path: then it is saved and closed.
Metres everywhere, to one scale on all axes.
"""

from ikjax.plot.bars import histogram
from ikjax.plot.contrast import Change, change, comparison
from ikjax.plot.disc import globe
from ikjax.plot.planes import Plane, Slice
from ikjax.plot.slices import reach_map
from ikjax.plot.solid import isosurface, nested
from ikjax.plot.stick import Sticks, arm, branches, sticks
from ikjax.plot.style import file_types
