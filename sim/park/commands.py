"""Commands of this package; heavy libraries load only when one runs."""

from pathlib import Path
from typing import Annotated, Any

import typer

from rover_ncp.core.console import MOST_SEED, Json, Output, Overwrite
from rover_ncp.core.errors import FileError, UsageError


def park(
    *,
    policy: Annotated[
        str | None,
        typer.Option(
            help="Park with this policy (name or file) instead of training one.", show_default=False
        ),
    ] = None,
    course: Annotated[str, typer.Option(help="Course to drive, by name or YAML file.")] = "parking",
    seed: Annotated[int, typer.Option(min=0, max=MOST_SEED, help="Root seed of the training.")] = 0,
    out: Annotated[Path, typer.Option(help="Folder for training, recording, picture and logs.")] = Path(
        "runs/park"
    ),
    overwrite: Overwrite = False,
    json: Json = False,
) -> int:
    """Train a circuit until it parks in simulation, then park a robot with it, all in one go.

    The robot is a mock Pioneer that speaks the real protocol over TCP; bridge and driver are the same
    processes that drive a real one, and talk over Zenoh. Whether it parked is judged on the true pose, which
    the driver never sees. Ends with 0 parked, 1 not parked, or with the exit code of what failed.
    """
    from rover_ncp.course.course import load_course
    from sim.learn.progress import TrainProgress
    from sim.learn.rollout import rollout
    from sim.park.park import PARK_ITERATIONS, require_free, train_until_parked
    from sim.park.park import park as park_with

    output = Output(json)
    known = load_course(course)
    require_free(out, overwrite=overwrite)
    training: dict[str, Any] | None = None
    if policy is None:
        folder = out / "train"
        _clear_own(folder, overwrite=overwrite)
        output.say("training twelve agents until the best one parks in simulation")
        with TrainProgress(PARK_ITERATIONS) as progress:
            result = train_until_parked(course, seed, folder, progress.show)
        training = {
            "best_return": result.agents.best.value,
            "returns": result.agents.returns,
            "iterations": result.agents.iterations,
            "iterations_per_s": result.iterations_per_s,
        }
        verdict = rollout(result.policy, known).verdict
        summary = f"best return {result.agents.best.value:.4f} after {result.agents.iterations} iterations"
        if not verdict.parked:
            fields = {"parked": False, "reason": f"no agent parks: {verdict.reason}", "train": training}
            output.result(fields, f"not parked: no agent parks in simulation yet ({summary})")
            return 1
        output.say(f"{summary}: it parks in simulation")
        policy = str(result.policy_path)
    parked = park_with(policy, course, out, output.say, overwrite=overwrite)
    verdict, estimate, bridge = parked.verdict, parked.estimate, parked.bridge
    fields = {
        "parked": verdict.parked,
        "reason": verdict.reason,
        "true_error_m": verdict.error_m,
        "true_error_rad": verdict.error_rad,
        "estimate_error_m": estimate["estimate_error_m"],
        "estimate_error_rad": estimate["estimate_error_rad"],
        "ticks": estimate["ticks"],
        "overruns": estimate["overruns"],
        "recording": str(parked.recording),
        "picture": str(parked.picture),
        "report": str(parked.report),
        "policy": policy,
        "pids": parked.pids,
        "bytes_to_base": bridge.get("bytes_to_base"),
        "bytes_from_base": bridge.get("bytes_from_base"),
        "train": training,
    }
    ending = "parked" if verdict.parked else f"not parked: {verdict.reason}"
    output.result(
        fields,
        f"{ending}; truly {1000 * verdict.error_m:.0f} mm and {1000 * verdict.error_rad:.0f} mrad off\n"
        f"picture: {parked.picture}\nrecording: {parked.recording}\nreport: {parked.report}",
    )
    return 0 if verdict.parked else 1


def _clear_own(folder: Path, *, overwrite: bool) -> None:
    """Remove an earlier run of park's training; a folder that holds anything else is left alone."""
    import shutil

    if not folder.exists():
        return
    if not overwrite:
        raise FileError(f"{folder}: exists already; choose another --out, or add --overwrite")
    if not (folder / "settings.yaml").is_file() and any(folder.iterdir()):
        raise FileError(f"{folder}: is not empty and holds no training of an earlier park")
    shutil.rmtree(folder)


def evaluate(
    policy: Annotated[
        str,
        typer.Argument(
            help="Policy to score: a name, a YAML file, or a circuit in the published .bnn format."
        ),
    ],
    *,
    course: Annotated[
        list[str] | None,
        typer.Option(
            help="Course to drive, by name or YAML file; repeat for more, which trials take in turn.",
            show_default="parking",
        ),
    ] = None,
    trials: Annotated[
        int | None, typer.Option(min=1, max=10**6, help="Number of random trials.", show_default="1")
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, max=MOST_SEED, help="Root seed of the trials and random courses.")
    ] = 0,
    randomize: Annotated[
        str | None,
        typer.Option(help="Ranges of the trials: none, mild, full, harsh or YAML file.", show_default="none"),
    ] = None,
    random_courses: Annotated[
        int | None,
        typer.Option(
            min=1, max=10_000, help="Number of random courses, driven in turn instead.", show_default=False
        ),
    ] = None,
    stack: Annotated[
        bool,
        typer.Option("--stack", help="Drive through firmware, bridge and driver, on a virtual clock."),
    ] = False,
    live: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=10_000,
            help="Number of trials that are driven as real processes, in real time.",
            show_default=False,
        ),
    ] = None,
    profile: Annotated[
        Path | None,
        typer.Option(
            help="Rover profile, as 'identify' writes it; values not in it are drawn.",
            show_default=False,
        ),
    ] = None,
    processes: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1000,
            help="Processes. With --stack they change the speed, not the result. With --live: runs at once.",
            show_default="one for each core; 1 live",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="With --live: folder for recordings and logs.")] = Path(
        "runs/live"
    ),
    task: Annotated[
        str | None,
        typer.Option(
            help="Play one of the paper's benchmarks with a circuit, YAML or .bnn.", show_default=False
        ),
    ] = None,
    range_: Annotated[
        list[str] | None,
        typer.Option(
            "--range", help="With --task: limit of a sensor's range, as NAME=LIMIT.", show_default=False
        ),
    ] = None,
    json: Json = False,
) -> int:
    """Drive a course in simulation with a policy, and score it.

    Without --trials or --randomize, the policy drives once, on the nominal rover model:

    The return is the paper's: minus the squared misses of all checkpoints, 1 rad counting as 1 m; 0 is out of
    reach, doing nothing on the parking course scores -14.18. A .bnn circuit gets the sensors it was trained
    with, which are not clamped.

    With one of them, the policy drives randomised rovers. Each trial has its own delays, gains, noise and
    start, which follow from the seed and the trial's number alone. The true motion is scored.

        rover-ncp eval course --trials 1000 --randomize full
        rover-ncp eval course --trials 1000 --randomize full --random-courses 200

    --stack drives the same trials as encoded bytes through the firmware of a mock Pioneer, the bridge with
    its gate, and the driver with its estimator. Only sockets and waiting differ from driving a robot.

        rover-ncp eval course --trials 300 --randomize full --stack

    --live drives each of them as three real processes, over TCP and Zenoh. The driver does not know the mock
    robot's errors. With --stack too, trials are driven both ways, and the distance between their ends is
    printed.

        rover-ncp eval course --live 4 --randomize full --course parking --course bay

    Without --stack, kanayama, pure-pursuit and smooth in place of a policy are classical tracking laws.

    --task plays episodes (--trials, 100) of one of the paper's other benchmarks; see 'paper'.

        rover-ncp eval mine.bnn --task mountain-car --range position=1.0 --range velocity=0.02

    Ends with 1 if a single trial was driven and did not park, else with 0.
    """
    from rover_ncp.circuit.policy_file import load_policy
    from rover_ncp.course.course import load_course
    from sim.learn.rollout import rollout

    output = Output(json)
    if task is not None:
        if course or stack or live or profile or randomize or random_courses:
            raise UsageError("--task goes with --range, --trials and --seed alone")
        return _evaluate_task(output, policy, task, range_ or [], trials=trials, seed=seed)
    if range_:
        raise UsageError("--range needs --task")
    courses = tuple(course or ["parking"])
    if processes is not None and not (stack or live):
        raise UsageError("--processes needs --stack or --live")
    once = trials is None and randomize is None and random_courses is None and live is None
    if stack or len(courses) > 1 or profile is not None or not once:
        from sim.evaluate.trial_runs import TrialOptions, run_trials

        options = TrialOptions(
            policy,
            courses,
            trials or live or 1,
            seed,
            "none" if randomize is None else randomize,
            random_courses or 0,
            profile,
            stack,
            live,
            processes,
            out,
        )
        return run_trials(output, options)
    known = load_course(courses[0])
    run = rollout(load_policy(policy), known)
    verdict = run.verdict
    fields = {
        "return": run.total,
        "parked": verdict.parked,
        "reason": verdict.reason,
        "error_m": verdict.error_m,
        "error_rad": verdict.error_rad,
        "rms_m": run.rms_m,
    }
    ending = "parked" if verdict.parked else f"not parked: {verdict.reason}"
    output.result(
        fields,
        f"{ending}; return {run.total:.4f}, {1000 * verdict.error_m:.0f} mm and "
        f"{1000 * verdict.error_rad:.0f} mrad off at the end, {1000 * run.rms_m:.0f} mm rms on the way",
    )
    return 0 if verdict.parked else 1


def _evaluate_task(
    output: Output, policy: str, task: str, ranges: list[str], *, trials: int | None, seed: int
) -> int:
    """Play a benchmark, and report; 1 if a single episode was played and no success."""
    from sim.paper.score_file import EPISODES, score_circuit

    found = score_circuit(policy, task, ranges, trials or EPISODES, seed)
    output.result(
        found,
        f"{task}: return {found['return']:.2f} ± {found['std']:.2f} in {found['episodes']} episodes, "
        f"{found['successes']} of them a success",
    )
    return 1 if trials == 1 and not found["success"] else 0
