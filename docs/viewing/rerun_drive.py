"""Show a recording in Rerun: path, poses and frames from above, neurons, and the states of driver and gate.

    pip install rerun-sdk
    python docs/viewing/rerun_drive.py run.mcap
    python docs/viewing/rerun_drive.py run.mcap --save run.rrd

The second form writes recording and layout into one file for ``rerun run.rrd``.
"""

import argparse
from pathlib import Path
from typing import Any

ABOVE = ("deploy/path", "deploy/pose", "truth/pose", "tf", "tf_static", "deploy/frames")
NEURONS = "neurons"
"""All neurons of a circuit are below it, each a topic."""
TEXTS = {"rover/status": "Driver", "rover/gate": "Gate"}


def blueprint() -> Any:
    """Return the layout."""
    import rerun.blueprint as rrb

    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial3DView(
                    name="From above",
                    contents=[f"/{topic}" for topic in ABOVE],
                    spatial_information=rrb.SpatialInformation(target_frame="course"),
                    eye_controls=rrb.EyeControls3D(position=(0.4, 0.25, 2.5), look_target=(0.4, 0.25, 0.0)),
                ),
                rrb.Horizontal(
                    *(rrb.TextDocumentView(name=name, origin=f"/{topic}") for topic, name in TEXTS.items())
                ),
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
    rr.log_file_from_path(chosen.recording)


if __name__ == "__main__":
    main()
