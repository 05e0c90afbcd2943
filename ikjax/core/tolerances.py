"""Every tolerance of the library, with its reason.

Numbers that decide whether two things count as equal, near or zero stand here and nowhere else. Lengths are
in units of the arm's reach and angles in radians unless a line says otherwise. Where there are two values,
the first is for float32: its rounding, 1.2e-7, is half a billion times that of float64.
"""

# Poses and rotations

ROTATION = 1e-5
"""`solve` masks a goal whose |R^T R - I| is larger. Matrices stored in float32 are off by some
1e-7: that leaves room for a few products of them."""

NEARLY_ROTATION = 1e-2
"""Up to this |R^T R - I| the nearest rotation stands for the goal, in `project`, `refine`, `track` and with
`pose(matrix=..., orthonormalize=True)`: entries typed with three decimals are off by up to some 3e-3."""

EXACT_ROTATION = 1e-14
"""|R^T R - I| of a rotation that is right to float64's rounding is less: such a base or tool stays as
given."""

LARGEST_ENTRY = 1e6
"""Entries of a goal's rotation are clipped to this, because their fourth power must be finite in float32."""

FARTHEST_GOAL = 1e6
"""[reaches] Goals beyond are answered as if they stood there, so that no power of their distance
overflows."""

MILLIMETRES = 10
"""[reaches] Goals beyond are taken for millimetres. A goal within reach is, in millimetres, a hundred reaches
away or more, unless it is within a hundredth of the reach of the base."""

# Arms, as given and as recognized

FACT = 1e-10
"""How far a fact of a family (axes parallel, square, meeting) may be off and still count. It is well below
the 1e-9 of `VALID`, so that an arm that is recognized can be solved."""

AXIS_LADDER = (1e-5, 1e-4, 1e-3)
"""Values of `axis_tolerance` that are tried in turn; the first that gives a family is taken. Official files
are off by 1.4e-4 (AgileX PiPER), 2.0e-4 (Doosan M and A) and 3.7e-4 (Kinova Gen3)."""

LARGEST_AXIS_TOLERANCE = 0.02
"""The largest `axis_tolerance` that is accepted; an arm that is further off is not taken for one of the
family."""

UNSEEN = 0.01
"""A correction below this share of `VALID` cannot decide whether a pose is valid: it is left out."""

COMPLETE = 3e-4
"""Largest correction of an arm whose slots hold every solution (`Arm.complete`). Of 2,000 random goals 2 to 7
missed a solution at 1e-3 and none did at 1e-4."""

TABLE_SPREAD = 30
"""[sizes of the arm] A DH table with larger numbers is rewritten: they make up for each other and hide the
arm."""

FARTHEST_NORMAL = 4
"""[sizes of the arm] Where axes are nearly parallel, a common normal farther along them is not looked for."""

NEARLY_PARALLEL = 0.03
"""Axes within this angle count as nearly parallel there; a correction can take up 0.05."""

MIMIC_PARALLEL = 1e-6
"""Axes of a joint and of its mimic that are parallel to so much add up to one joint."""

LONGEST_LENGTH = 1e100
"""[m] Beyond this a length is a mistake: its square no longer fits a float64."""

SPLITS = {"regional": 3e-4, "parallel_axes": 1e-5}
"""Equations off by less from one that splits, in shares of the size or sines, are solved as if they split,
with the rest as a correction."""

NEARLY_SPLITS = {"nearly": 3e-4, "nearly in float32": 0.03}
"""Equations off by less are solved with care for close pairs of roots. Measured on 2,000 goals an arm: the
quartic alone leaves goals unanswered below 1e-4 in float64 and below 3e-2 in float32."""

# Closed forms

VALID = {"float32": 2e-5, "float64": 1e-9}
"""A slot is valid when its pose, by forward kinematics, is this close: rotation in rad, position as a share
of (reach + |p|). Tighter would drop true answers beside singularities, where a closed form itself is off by
1e-12."""

TINY = 64
"""[eps] Lengths and sines below count as zero. The number is a choice, not a derived bound."""

SHORT_HAND = 1e-3
"""The least that counts as a hand's length; a shorter one turns about the point itself."""

ROOT_NOISE = 4096
"""[eps] Noise of a trigonometric polynomial of an offset wrist, whose largest value is one: it says how far
rounding may have moved a root. A choice: its two eliminations lose digits by different factors."""

WAY_STEP = 0.02
"""[rad] The largest step from a root of that polynomial to the root of one way, and the largest distance that
counts as rounding. A choice."""

ONE_WAY = 64
"""A way whose root is nearer than those of the others by this factor is the only one. A choice."""

KEEPS_JOINT_6 = 0.05
"""Joint 1 is no variable where its weight falls below this share of the squared radius of the wrist's circle,
unless that of joint 6 is less still. A choice."""

# Projection and gradients

CONVERGED = {"float32": 2e-5, "float64": 1e-8}
"""The gradient norm below which a descent counts as converged, see `ik.newton.projected_gradient_norm`: some
hundred roundings in float32, the square root of one in float64."""

CURVATURE_FLOOR = 1e-6
"""[reaches^2/rad^2] The least curvature that a Newton step divides by."""

NEARLY_FLAT = 1e-3
"""Where the gradient is less, directions of negative curvature are followed: the start may be a saddle."""

SADDLE_PUSH = 0.1
"""[rad, or reaches] How far a step goes along such a direction."""

SAME_COST = {"float32": 1e-5, "float64": 1e-10}
"""Least costs that differ by less, relatively, are one: several branches stand in one pose."""

SAME_ERROR = {"float32": 1e-4, "float64": 1e-7}
"""[reaches, or rad] With a priority, first errors this close count as equal, and the second decides."""

LAST_WEIGHT = {"float32": 1e-3, "float64": 1e-6}
"""Weight of the square of the second error in the last stage of a priority: much less is lost in rounding."""

TRACK_SLACK = 1e-3
"""A path's next pose may be missed by so much before it counts as left."""

GRADIENT_DAMPING = 16
"""[square roots of eps] Default damping of `solve`'s derivatives: below it, J^T J is rounding."""

# Verification and certified maps

REGULAR = {"float32": 3e-2, "float64": 1e-4}
"""Least singular value of the task's Jacobian from which on `verify` must find the joints again."""

FOUND_AGAIN = {"float32": 1e-6, "float64": 1e-8}
"""Joints count as found again within this over that singular value."""

DOUBTFUL_FOLD = 64
"""[tolerances] A slot so near its fold is doubtful in float32, and solved again where a map is certified."""

DOUBTFUL_MISSES = 1 / 16, 8.0
"""[tolerances] A slot whose pose error is between these is doubtful."""

DOUBTFUL_LIMIT = 1e-3
"""[rad, m] A slot so near a joint limit is doubtful: a thousand roundings or more, as much as a joint near a
singularity makes of one."""

# Synthesis

CONSTRAINT_MET = 1e-4
"""Constraints of a design that are above zero by less count as met."""
