"""`project`: the attainable pose nearest to any goal.

Storey: ik. The closed form finds the basins, Newton's steps go to their bottoms.
"""

from ikjax.arm.arm import Arm
from ikjax.ik.projection import Projection
from ikjax.ik.refine import STEPS, best_of, checked, descended
from ikjax.ik.solve import check_family


def project(arm: Arm, goals, length: float = 0.1, *, steps: int = STEPS) -> Projection:
    """The attainable pose nearest to each goal, within the joint limits.

    Nearest is what minimises |dp|^2 + (length * angle)^2; see `refine`. Every branch of the closed form is a
    start: for five joints of family `five_axis` with the goal's point held and the orientation as near as
    that allows (the nearest reachable point where it is out of reach), for all others the branches of
    `solve`, clamped.

    Args:
        arm: An arm with a family.
        goals: T_world_tool, (..., 4, 4), float32 or float64. A goal that is no pose is never `converged`.
        length: What a radian is worth [m]; positive.
        steps: At most so many steps of refinement from each branch; with none, the closed form alone.

    Returns:
        `Projection`: the best branch, and all of them as `.branches`, (..., S) with S = len(arm.branches).
        Slopes as in `refine`.

    Raises:
        ValueError: Wrong shapes or types, or an arm of no family.
    """
    check_family(arm)
    goals, arm = checked(arm, goals, length)
    return best_of(descended(arm, goals, None, length, steps))
