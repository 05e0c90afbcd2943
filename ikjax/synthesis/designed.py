"""What a design study found."""

import dataclasses

import numpy as np

from ikjax.arm.arm import Arm


@dataclasses.dataclass(frozen=True, eq=False)
class Designed:
    """The best arm of a design study, how it was found, and what it still cannot do."""

    arm: Arm
    """The best of all starts, by the exact score; the first one as it began is among them."""
    start: Arm
    """The arm that was given."""
    values: dict[str, float]
    """What moved, by name [m, rad]; shifts and turns of base and tool from where they were."""
    score: float
    """The objective of `arm`, exact."""
    start_score: float
    """That of the given arm, moved between the bounds and tied where it was not."""
    reached: np.ndarray
    """bool, the goals' shape: what `arm` reaches, by `solve` and, where limits count, `within_limits`."""
    margin: np.ndarray
    """[m], the goals' shape: of each goal's best branch, joint limits left out."""
    scores: np.ndarray
    """(starts,) exact scores in the end."""
    numbers: np.ndarray
    """(starts, k) what moved, in the end, in the order of `values`."""
    history: np.ndarray
    """(steps, starts) the score as it was climbed: with its blur, and over the batch of the step."""
    violation: float
    """How far the worst constraint of `arm` is above zero; -inf without constraints."""
    left_out: np.ndarray
    """Rows of the goals that hold what is no pose."""
    goals: np.ndarray
    """The goals of `reached`: without those rows."""

    def report(self, most: int = 10) -> str:
        """The study in a few lines for people, with the goals that are worst out of reach."""
        lines = [
            f"{self.start.name}: score {self.start_score:.4g} -> {self.score:.4g}, the best of "
            f"{len(self.scores)} starts ({self.scores.min():.4g} to {self.scores.max():.4g}) "
            f"after {len(self.history)} steps"
        ]
        for name, value in self.values.items():
            unit = "rad" if name.rpartition(".")[2].startswith("r") or name[:2] in ("al", "th") else "m"
            lines.append(f"  {name:8} {value:+.5f} {unit}")
        if self.violation > -np.inf:
            lines.append(f"  constraints: the worst is {self.violation:+.2g}, wanted at most 0")
        lost = np.argwhere(~self.reached)
        lines.append(f"  goals: {self.reached.sum():,} of {self.reached.size:,} reached")
        if len(self.left_out):
            lines.append(
                f"  left out: {len(self.left_out)} rows that hold no pose, the first {self.left_out[0]}"
            )
        order = np.argsort(self.margin[~self.reached])[:most]
        for index in lost[order]:
            place, margin = self.goals[tuple(index)][:3, 3], self.margin[tuple(index)]
            name = ", ".join(map(str, index))
            why = "beyond the joint limits" if margin > 0 else f"{-1000 * margin:.1f} mm out of reach"
            lines.append(f"    goal {name} at ({', '.join(f'{x:.3f}' for x in place)}): {why}")
        if len(lost) > len(order):
            lines.append(f"    and {len(lost) - len(order)} more")
        return "\n".join(lines)
