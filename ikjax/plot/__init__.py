"""Pictures: workspaces as slices, solids, discs and points, two of them compared; branches, self-motions, an
arm.

Needs matplotlib (`pip install ikjax[viz]`), which is imported for the first picture. A figure stays open for
`plt.show()`; with a path it is saved and closed. All lengths are in metres, with the same scale on all axes.
"""

from ikjax.plot.arm_viewer import ArmViewer, view
from ikjax.plot.bars import histogram, limit_costs
from ikjax.plot.contrast import Change, change, comparison
from ikjax.plot.disc import globe
from ikjax.plot.plan import plan
from ikjax.plot.planes import Plane, Slice
from ikjax.plot.redundant import self_motion
from ikjax.plot.slices import reach_map
from ikjax.plot.solid import isosurface, nested
from ikjax.plot.stick import Sticks, arm, branches, sticks
from ikjax.plot.style import file_types
