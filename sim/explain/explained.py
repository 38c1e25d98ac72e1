"""Findings about one circuit on one course, in one value."""

from dataclasses import dataclass
from typing import Any

from deploy.report.analysis import Analysis
from deploy.report.interpretation import Contribution
from deploy.report.published import CONTRIBUTIONS, TIME_CONSTANTS_S
from deploy.report.sentences import Explanation
from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import Course, Verdict
from sim.explain.knockout import Knockout
from sim.explain.sensitivity import Sensitivity
from sim.learn.rollout import Rollout


@dataclass(frozen=True, eq=False)
class Explained:
    """Findings of ``rover-ncp explain``."""

    source: str
    policy: Policy
    course: Course
    verdict: Verdict
    """Verdict on the explained run."""
    intact: Rollout
    """The simulated run, against which the what-ifs are held."""
    analysis: Analysis
    knock_outs: tuple[Knockout, ...]
    sensitivities: tuple[Sensitivity, ...]

    def fields(self) -> dict[str, Any]:
        """Return everything but the potentials as plain values."""
        analysis, pairs = self.analysis, [(a, b) for b in self.analysis.motors for a in self.analysis.sources]
        return {
            "source": self.source,
            "policy": self.policy.circuit.name,
            "course": self.course.name,
            "run": {
                "parked": self.verdict.parked,
                "reason": self.verdict.reason,
                "error_m": self.verdict.error_m,
                "error_rad": self.verdict.error_rad,
            },
            "simulated": {"return": self.intact.total, "parked": self.intact.verdict.parked},
            "phases": [_phase(explanation) for explanation in analysis.explanations],
            "threshold": analysis.threshold,
            "contributions": [
                _contribution(analysis.contributions[pair], analysis.driving[pair]) for pair in pairs
            ],
            "time_constants": [
                {**row._asdict(), "paper_s": TIME_CONSTANTS_S.get(row.neuron)}
                for row in analysis.time_constants
            ],
            "knock_outs": [vars(row) for row in self.knock_outs],
            "sensitivities": [{**vars(row), "slope": row.slope} for row in self.sensitivities],
        }


def _phase(explanation: Explanation) -> dict[str, Any]:
    phase = explanation.phase
    return {
        "label": phase.label,
        "start_s": phase.start_s,
        "end_s": phase.end_s,
        "driven_m": phase.driven_m,
        "turned_rad": phase.turned_rad,
        "motor": explanation.motor._asdict(),
        "rival": explanation.rival._asdict() if explanation.rival else None,
        "behind": explanation.behind._asdict() if explanation.behind else None,
        "by_leak": explanation.by_leak,
        "activity": explanation.activity,
        "pulls": [pull._asdict() for pull in explanation.pulls],
        "change": explanation.change._asdict() if explanation.change else None,
        "sentence": explanation.text,
    }


def _contribution(whole: Contribution, driving: Contribution) -> dict[str, Any]:
    paper = CONTRIBUTIONS.get((whole.source, whole.destination))
    return {
        **vars(whole),
        "driving": {name: getattr(driving, name) for name in ("sign", "positive", "negative")},
        "paper": paper,
    }
