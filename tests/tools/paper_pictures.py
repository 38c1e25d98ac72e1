"""Draw docs/paper/ from the stored runs: learning curves, and each task by its best circuit.

``python tests/tools/paper_pictures.py [TASK...]``: without a task all of them. A scene is what MuJoCo or
Gymnasium's environment is in, seen from the side, so that no display and no OpenGL are needed.
"""

import math
import sys
from pathlib import Path

import gymnasium
import numpy as np
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from paper.store import BudgetName, ResultStore
from paper.tasks import PAPERS, TASKS, Benchmark, build_agent
from rover_ncp.circuit.runner import Runner
from rover_ncp.course.course import load_course
from sim.learn.rollout import rollout

ROOT = Path(__file__).parents[2]
OUT = ROOT / "docs" / "paper"
SIZE, SCALE = (480, 270), 2
"""Of a picture, and how much larger it is drawn."""
INK, GROUND, PALE, ACCENT = "#30343f", "#8d99ae", "#d8dee9", "#c8553d"
INPUTS = {"pendulum": [1, 0], "mountain-car": [0, 1], "half-cheetah": range(17)}
"""Entries of the observation that are the circuit's inputs."""
STEPS = {"pendulum": (250, 2, 80), "mountain-car": (999, 4, 80), "half-cheetah": (75, 1, 50)}
"""At most so many steps, steps between frames, and ms that a frame is shown."""


class Scene:
    """One frame: metres to the right and upwards become pixels."""

    def __init__(self, left, right, bottom, pixels_below=30):
        self.image = Image.new("RGB", [SCALE * side for side in SIZE], "white")
        self.draw = ImageDraw.Draw(self.image)
        self.scale = SCALE * SIZE[0] / (right - left)
        self.left, self.floor = left, SCALE * (SIZE[1] - pixels_below) + bottom * self.scale

    def at(self, x, z):
        return (x - self.left) * self.scale, self.floor - z * self.scale

    def line(self, points, color=INK, width_m=0.0):
        """Draw a line with round ends."""
        pixels, width = [self.at(*point) for point in points], max(round(width_m * self.scale), 2 * SCALE)
        self.draw.line(pixels, color, width, "curve")
        if width_m:
            for point in (points[0], points[-1]):
                self.dot(*point, width_m / 2, color)

    def dot(self, x, z, radius_m, color=INK):
        (a, b), r = self.at(x, z), radius_m * self.scale
        self.draw.ellipse([a - r, b - r, a + r, b + r], color)

    def done(self):
        return self.image.resize(SIZE, Image.Resampling.LANCZOS)


def capsules(scene, model, data):
    """Draw all capsules of a MuJoCo model, seen along y."""
    for geom in range(model.ngeom):
        if model.geom_type[geom] == 3:  # mjGEOM_CAPSULE
            middle, axis = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)[:, 2]
            radius, half = model.geom_size[geom][:2]
            ends = [middle + sign * half * axis for sign in (-1, 1)]
            color = GROUND if model.geom(geom).name == "rail" else INK
            scene.line([(end[0], end[2]) for end in ends], color, 2 * radius)


def draw_pendulum(world, _):
    scene = Scene(-1.3, 1.3, -0.35)
    capsules(scene, world.unwrapped.model, world.unwrapped.data)
    return scene.done()


def draw_half_cheetah(world, _):
    data = world.unwrapped.data
    here = float(data.qpos[0])
    scene = Scene(here - 1.6, here + 1.6, 0.0)
    scene.line([(here - 2, -0.02), (here + 2, -0.02)], GROUND, 0.03)
    for metre in range(math.floor(here) - 2, math.ceil(here) + 3):
        scene.line([(metre, -0.02), (metre, -0.12)], GROUND)
        scene.draw.text(scene.at(metre + 0.03, -0.06), f"{metre} m", GROUND, font_size=11 * SCALE)
    capsules(scene, world.unwrapped.model, data)
    return scene.done()


def draw_mountain_car(_, seen):
    scene = Scene(-1.5, 0.9, 0.1)
    places = np.linspace(-1.3, 0.7, 200)
    scene.line([(x, math.sin(3 * x) * 0.45 + 0.55) for x in places], GROUND)
    goal, place = 0.45, float(seen[0])
    scene.line([(goal, math.sin(3 * goal) * 0.45 + height) for height in (0.55, 0.75)], ACCENT)
    scene.dot(place, math.sin(3 * place) * 0.45 + 0.6, 0.045)
    return scene.done()


def benchmark(task, policy):
    """Return the frames of an episode in Gymnasium's environment."""
    world, runner = gymnasium.make(task.environment, disable_env_checker=True), Runner(policy)
    steps, each, _ = STEPS[task.name]
    seen, _ = world.reset(seed=1)
    draw = {"pendulum": draw_pendulum, "mountain-car": draw_mountain_car, "half-cheetah": draw_half_cheetah}
    frames, over = [], False
    for step in range(-task.warm_up, steps):
        action = runner.tick([float(seen[entry]) for entry in INPUTS[task.name]])
        if step < 0:
            continue
        if step % each == 0:
            frames.append(draw[task.name](world, seen))
        seen, _, terminated, truncated, _ = world.step(np.array(action, np.float32))
        over = terminated or truncated
        if over:
            break
    return frames


def parking(_, policy):
    """Return the frames of a drive, seen from above."""
    course = load_course("parking")
    poses, frames = rollout(policy, course).poses, []
    for tick in range(0, 240, 3):
        scene = Scene(-0.35, 1.25, -0.15)
        for point in course.checkpoints:
            scene.dot(point.x, point.y, 0.012, PALE)
        scene.line([(x, y) for x, y, _ in poses[: tick + 2]], ACCENT)
        x, y, heading = poses[tick]
        ahead, aside = (
            np.array([math.cos(heading), math.sin(heading)]),
            [-math.sin(heading), math.cos(heading)],
        )
        for side in (-0.06, 0.06):
            wheels = np.array([x, y]) + side * np.array(aside)
            scene.line([wheels - 0.08 * ahead, wheels + 0.08 * ahead], INK, 0.03)
        scene.line([(x, y), (x + 0.11 * ahead[0], y + 0.11 * ahead[1])], INK, 0.04)
        frames.append(scene.done())
    return frames


def best(store, task):
    """Return the published search's best circuit of a task, None without a run."""
    runs = store.results(task.name, "circuit")
    if not runs:
        return None
    run = max(runs, key=lambda run: run.mean)
    return build_agent(task, "circuit", run.name.seed).with_parameters(run.parameters.array())


def curves(store, path):
    """Draw the learning curves of the published search, as in the paper's figure 4."""
    # Rewards by distance have another unit than the threshold.
    tasks = [task for task in TASKS.values() if not task.distance_of and store.results(task.name, "circuit")]
    figure = Figure(figsize=(10.2, 2.6 * -(-len(tasks) // 3)), dpi=100, layout="constrained")
    panels = list(figure.subplots(-(-len(tasks) // 3), 3, squeeze=False).flat)
    for axes, task in zip(panels, tasks, strict=False):
        for agent, color in zip(PAPERS, ("tab:blue", "tab:orange", "tab:green", "tab:red"), strict=True):
            runs = store.results(task.name, agent, BudgetName.PUBLISHED)
            if not runs:
                continue
            marks = np.geomspace(1.0, runs[0].settings["iterations"], 200)
            values = np.array([[run.value_after(int(mark)) for mark in marks] for run in runs])
            middle, spread = values.mean(axis=0), values.std(axis=0, ddof=min(len(runs) - 1, 1))
            axes.fill_between(marks, middle - spread, middle + spread, color=color, alpha=0.15, linewidth=0)
            axes.plot(marks, middle, color=color, linewidth=1.5, label=f"{agent} ({len(runs)})")
        axes.axhline(task.success, color="0.6", linewidth=0.8, linestyle=":")
        if task.success < 0:
            axes.set_ylim(-6.0, 0.3)  # with a lower return a rover does not drive to the goal
        axes.set_title(task.title, fontsize=8)
        axes.set_xscale("log")
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    for axes in panels[len(tasks) :]:
        axes.set_visible(False)
    figure.supxlabel("iterations", fontsize=9)
    figure.supylabel("estimated return of the best so far", fontsize=9)
    figure.savefig(path, metadata={"Software": None})


def main(names):
    store = ResultStore(ROOT / "paper" / "results")
    for name in names or ["curves", *STEPS, "parking"]:
        if name == "curves":
            curves(store, OUT / "curves.png")
            continue
        task = TASKS[name]
        policy = best(store, task)
        if policy is None:
            print(f"{name}: no run of a circuit is stored, so no picture is drawn")
            continue
        frames = (benchmark if isinstance(task, Benchmark) else parking)(task, policy)
        path, shown = OUT / f"{name}.webp", STEPS[name][2] if name in STEPS else 80
        frames[0].save(path, save_all=True, append_images=frames[1:], duration=shown, loop=0, quality=50)
        print(f"{path.relative_to(ROOT)}: {len(frames)} frames, {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
