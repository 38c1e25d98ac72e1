"""Show a recording in Rerun: the path from above, the neurons, and the states of driver and gate.

    pip install rerun-sdk
    python docs/viewing/rerun_drive.py run.mcap
    python docs/viewing/rerun_drive.py run.mcap --save run.rrd

The second form writes recording and layout into one file for ``rerun run.rrd``. Rerun reads the recording
itself but draws no path of poses, which this adds.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

import rover_ncp

PATHS = {"rover/estimate": (0, 114, 178), "truth/pose": (213, 94, 0)}
"""Topics of poses in the course's frame, with the colours of their paths."""
NEURONS = "neurons"
"""All neurons of a circuit are below it, each a topic."""
TEXTS = {"rover/status": "Driver", "rover/gate": "Gate"}


def blueprint() -> Any:
    """Return the layout."""
    import rerun.blueprint as rrb

    above = rrb.EyeControls3D(position=(0.4, 0.3, 2.0), look_target=(0.4, 0.3, 0.0), eye_up=(0.0, 1.0, 0.0))
    texts = (rrb.TextDocumentView(name=name, origin=f"/{topic}") for topic, name in TEXTS.items())
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(name="Paths from above", origin="/paths", eye_controls=above),
                rrb.Horizontal(*texts),
                row_shares=[3, 1],
            ),
            rrb.TimeSeriesView(name="Neurons (mV)", origin=f"/{NEURONS}"),
        ),
        collapse_panels=True,
    )


def main() -> None:
    """Open the viewer, or write a file for it."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("recording", type=Path)
    options.add_argument("--save", type=Path)
    chosen = options.parse_args()
    import rerun as rr

    rr.init("rover-ncp", spawn=chosen.save is None, default_blueprint=blueprint())
    if chosen.save is not None:
        rr.save(chosen.save, default_blueprint=blueprint())
    arrays = rover_ncp.read_arrays(chosen.recording)
    for topic, color in PATHS.items():
        if topic in arrays:
            poses = arrays[topic]
            line = np.column_stack([poses["x"], poses["y"], np.zeros(len(poses))])
            path = rr.LineStrips3D([line], colors=[color], labels=[topic], radii=rr.Radius.ui_points(2.0))
            rr.log(f"paths/{topic}", path, static=True)
    rr.log_file_from_path(chosen.recording)


if __name__ == "__main__":
    main()
