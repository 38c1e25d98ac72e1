"""Published results of the parking circuit of Hasani et al. (ICRA 2020), for comparison."""

from deploy.report.interpretation import Sign

CONTRIBUTIONS: dict[tuple[str, str], Sign] = {
    ("AVM", "RGT"): Sign.POSITIVE,
    ("AVD", "RGT"): Sign.POSITIVE,
    ("AVA", "RGT"): Sign.POSITIVE,
    ("PVD", "RGT"): Sign.ANTAGONISTIC,
    ("PLM", "RGT"): Sign.ANTAGONISTIC,
    ("PVC", "RGT"): Sign.ANTAGONISTIC,
    ("DVA", "RGT"): Sign.PHASE_SWITCHING,
    ("AVB", "RGT"): Sign.PHASE_SWITCHING,
}
"""To the right-turn neuron (section VI and supplement); none are published for ALM."""

TIME_CONSTANTS_S: dict[str, tuple[float, float]] = {
    "DVA": (0.066, 0.17),
    "PVC": (0.013, 0.37),
    "AVD": (1.98e-4, 9.65e-4),
    "AVB": (2.95, 2.95),
    "AVA": (0.12, 0.56),
    "LFT": (2.9e-4, 2e-3),
    "RGT": (0.61, 0.72),
    "FWD": (4.045, 4.05),
}
"""Least and largest over the parking run (Table S7)."""
