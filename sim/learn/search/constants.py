"""Constants of the Gauss-Newton search."""

from dataclasses import dataclass

_CHECKPOINTS = 22
"""Of the parking course, by whose returns the limits were found."""


@dataclass(frozen=True)
class GaussNewtonConstants:
    """Constants of the Gauss-Newton search, tuned on seeds that no reported figure uses (``docs/search.md``).

    Points are in the unit box, so that shares and deviations are fractions of each parameter's range. A loss
    is minus the return. Limits of a loss are per checkpoint, in m² (1 rad counts as 1 m).
    """

    # -- where descents start --
    samples: int = 50
    """Candidates around the untuned parameters, of which the best starts a descent."""
    sample_spread: float = 0.1
    """Standard deviation of the samples."""
    restarts: int = 10
    """Candidates of a restart: copies of the origin with some parameters moved."""
    restart_share: float = 0.1
    """Share of the parameters that a candidate of a restart moves."""
    wide_restart_share: float = 0.2
    """The same where the best is good."""
    restart_spread: float = 0.2
    """Standard deviation of a moved parameter."""
    races: int = 60
    """Further batches of candidates where the best is good; they race against the best before them."""
    good_loss: float = 0.07 / _CHECKPOINTS
    """Loss of the best below which every descent is a restart from it."""
    fair_loss: float = 1.0 / _CHECKPOINTS
    """Loss of the best above which every descent starts from samples."""
    patience: int = 4
    """Restarts without gain, from an origin that is close, after which samples are drawn; otherwise one."""
    gain_of_restart: float = 0.1
    """Share of the origin's loss that a restart must take off to count as a gain."""
    near_best: float = 3.0
    """Restarts begin where a descent from samples ended if its loss is less than the best's times this."""

    # -- steps --
    probe: float = 3e-3
    """Step of a finite difference."""
    step_dampings: tuple[float, ...] = (0.2, 10.0)
    """Dampings of a batch's steps as factors of the damping that worked last; far from the goal the first."""
    first_damping: float = 0.1
    min_damping: float = 1e-7
    max_damping: float = 1e4
    damping_after_failure: float = 10.0
    """Factor of the damping when no step of a batch gained."""

    # -- what is climbed, and until when --
    lifetime: float = 5.0
    """Loss (m², summed) after which a checkpoint counts 1/e in the survival."""
    close_loss: float = 0.3 / _CHECKPOINTS
    """Loss below which the return itself is climbed."""
    stalled_loss: float = 2.0 / _CHECKPOINTS
    """Loss below which a stalled climb of the survival continues with the return."""
    near_loss: float = 0.1 / _CHECKPOINTS
    """Loss below which a climb of the return may be slow."""
    window: int = 80
    """Steps over which the gain of a descent is measured."""
    min_gain: float = 0.01
    """Share of what is left to gain that a window must gain."""
    min_gain_of_return: float = 0.05
    """The same for a return that is not near: at ``min_gain`` a crawl takes half an agent's candidates."""
    overtaking_window: int = 30
    overtaking_windows: float = 4.0
    """A climb of the return ends if, at the pace of the last ``overtaking_window`` steps, so many times as
    many would not reach the best."""

    # -- dead parameters --
    dead_effect: float = 0.01
    """Change of a residual (m, rad) that counts as none."""
    revival_moves: tuple[float, ...] = (0.05, 0.15, 0.4)
    """How far dead parameters are moved, up and down."""
    max_dead: int = 16
    """The most parameters that are moved: those with the smallest slopes."""
    revival_price: float = 0.1
    """Share of the checkpoints not yet survived that may be lost for an effect."""
    revivals: int = 2
    """How often a descent looks for dead parameters."""


CONSTANTS = GaussNewtonConstants()
