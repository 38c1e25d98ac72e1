"""The command ``eval``; heavy libraries load only when it runs."""

from rover_ncp.core.console import Output, command, reject
from rover_ncp.core.errors import UsageError
from sim.evaluate.options import EvalOptions
from sim.world.bodies import Body


@command
def evaluate(options: EvalOptions) -> int:
    """Drive a course in simulation with a policy, and score it.

    By default the policy drives one trial of each course, on the nominal rover model.

    The return is the paper's: minus the squared errors at all checkpoints, 1 rad counting as 1 m. 0 is out of
    reach. The result has the mean of all trials. A rover that does not move scores -14.18 on the parking
    course.

    With --randomize, the policy drives random trials. Each has its own delays, gains, noise and start, which
    follow from the seed and the trial's number alone. Without a randomization the trials of a course are the
    same: more than one for each course is an error. The true motion is scored.

        rover-ncp eval course --trials 1000 --randomize full
        rover-ncp eval course --trials 1000 --randomize full --random-courses 200

    --stack drives the same trials as encoded bytes through the firmware of a mock Pioneer, the bridge with
    its gate, and the driver with its estimator. Only sockets and waiting differ from driving a robot. The
    driver knows what --model and --profile tell it, and the noise of the odometry.

        rover-ncp eval course --trials 300 --randomize full --stack

    --body mujoco drives a rover with four wheels, friction, weight and motors, which can have a slope or
    cables under it. It does not move as the body of the training does: it turns more than its encoders
    report, and slides. --sensors gives the driver a gyro or a camera.

        rover-ncp eval course --trials 300 --stack --body mujoco --randomize varied --sensors gyro

    --model names another robot: its size, motion, delays and sensors, and the ranges in which robots of that
    model differ. A course becomes slower for a robot that is slower than a circuit's commands, and one with
    obstacles becomes larger for a larger robot; the result says so.

        rover-ncp eval course --trials 300 --stack --model turtlebot4

    module:name in place of a policy is a function of your own, or a class of such, in a module that Python
    finds, also in the working folder. It gets the signals that its attribute signals names, and returns v and
    omega. A method reset, if there is one, begins each trial.

        rover-ncp eval my_policy:Follow --trials 100 --randomize full

    --to docks at a place with a camera on the robot that sees tags there, by a noise model (docs/place.md).
    Docked is judged by the true pose.

        rover-ncp eval dock --stack --to home.yaml --trials 30 --body mujoco --randomize varied

    --card measures a circuit under the conditions of the shipped policies' cards and writes its card:
    policy.card.md beside policy.yaml, with the file's hash, the training's command and a table with 95 %
    intervals. --course names the course if the policy's file does not. The extra research is needed, and some
    minutes.

        rover-ncp eval policy.yaml --card

    Ends with 1 if a single trial was driven and did not park, else with 0.
    """
    if options.card:
        from sim.evaluate.card import run_card

        return run_card(options)
    reject("needs --card", overwrite=options.overwrite)
    if not options.stack:
        if options.body is Body.MUJOCO:
            raise UsageError("--body mujoco needs --stack: plain simulation is pymunk's")
        for name in ("to", "images", "sensors", "identify", "processes"):
            if getattr(options, name):
                raise UsageError(f"--{name} needs --stack")
    if options.identify and options.profile is not None:
        raise UsageError("--identify and --profile do not go together: both tell the driver of the robot")
    if options.to is not None:
        given = {"course": options.course, "identify": options.identify, "profile": options.profile}
        reject("does not go with --to", **given, random_courses=options.random_courses)
    else:
        reject("needs --to", images=options.images)
    if not options.images:
        reject("needs --images", scene=options.scene, blind=options.blind)
    return _run(options)


def _run(options: EvalOptions) -> int:
    """Drive trials; return 1 if a single one was driven and did not park or dock."""
    from sim.evaluate.results import measure, result_words

    found = measure(options)
    Output(options.json).result(found, "\n".join(result_words(found)))
    return 1 if found.trials == 1 and found.success_rate < 1 else 0
