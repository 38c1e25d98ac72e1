"""Scores parameter vectors by whole episodes, on one course or several, with or without random trials.

A return only falls, as every reward is negative: a candidate that is already worse than what it must beat
has lost, and stopping it changes no decision.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.circuit.compiled import Program, allocate_lanes, make_program, resting_potentials
from rover_ncp.circuit.policy import Policy
from rover_ncp.course.course import TICK_S, Course, due_checkpoints
from rover_ncp.course.reference import SIGNALS, Reference, needs_reference, plan_reference
from sim.learn.episode import IDLE, RESULTS, Lanes, Queue, Tasks, run_episodes
from sim.learn.rollout import require_driver
from sim.world.fleet import Fleet
from sim.world.pymunk_rover import require_free_start
from sim.world.randomization import Trials, nominal_trials
from sim.world.rover import SUBSTEP_S, RoverModel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEAST_LANES, MOST_LANES = 8, 24
"""Fewer leave vectors half empty; more gain nothing: all numbers should stay in a core's first cache."""
RACERS_PER_LANE = 6


class Outcomes(NamedTuple):
    """How episodes ended, each array (candidates, trials); m, rad, and their squares."""

    total: FloatArray
    """Returns."""
    error_m: FloatArray
    error_rad: FloatArray
    moved_m: FloatArray
    turned_rad: FloatArray
    """The most in the time to be still."""
    touched: NDArray[np.bool_]
    tracking_m2: FloatArray
    tracking_rad2: FloatArray
    """Mean squared distance and angle to the reference; of no meaning without one."""
    parked: NDArray[np.bool_]
    misses: FloatArray
    """(candidates, trials, checkpoints, 3) x, y and heading from each checkpoint when it was judged, 0 where
    a course has fewer: a return is minus the sum of their squares."""


class Evaluator:
    """Scores parameter vectors of one kind of policy. Not for several threads at once.

    With ``trials``, trial i is driven on course i modulo the number of courses; without, each course once
    as the model is. References are planned where the policy sees them and none are given.

    Raises ConfigError when the policy cannot drive or a course's start is blocked.
    """

    def __init__(
        self,
        policy: Policy,
        course: Course | Sequence[Course],
        model: RoverModel | None = None,
        trials: Trials | None = None,
        references: Sequence[Reference] | None = None,
    ) -> None:
        require_driver(policy)
        courses = [course] if isinstance(course, Course) else list(course)
        self.policy, self.courses, self.model = policy, courses, model or RoverModel()
        for each in courses:
            require_free_start(self.model, each)
        # Lanes are built for one set of obstacles, and drive the courses that have it.
        self._grounds = list(dict.fromkeys(each.obstacles for each in courses))
        self._ground = np.array([self._grounds.index(each.obstacles) for each in courses])
        if references is None and needs_reference(policy.sensing.inputs):
            references = [plan_reference(each) for each in courses]
        self._program = make_program(policy)
        self._signal_at = np.array([SIGNALS.index(name) for name in policy.sensing.inputs])
        self._tasks = _tasks(courses, references, self.model)
        ticks = int(self._tasks.ticks.max())
        self._nominal = trials is None
        self.change_trials(trials or nominal_trials(self.model, ticks))
        self._teams: dict[tuple[int, int], tuple[Fleet, Lanes]] = {}

    def change_trials(self, trials: Trials, first_course: int = 0) -> None:
        """Drive other trials from now on, trial i on course ``first_course`` + i modulo their number."""
        if trials.noise.shape[1] <= int(self._tasks.ticks.max()):
            raise ValueError(f"trials of {trials.noise.shape[1] - 1} ticks are too short for the courses")
        self._trials, self._first_course = trials, first_course
        delays = tuple(SUBSTEP_S * float(trials.delay[:, axis].max()) for axis in range(2))
        self._slowest = getattr(self, "_slowest", (0.0, 0.0))
        if any(a > b for a, b in zip(delays, self._slowest, strict=True)):
            # Commands wait longer than fleets made so far have room for.
            self._slowest = tuple(max(a, b) for a, b in zip(delays, self._slowest, strict=True))
            self._teams = {}

    def returns(self, vectors: ArrayLike, stop_below: ArrayLike | None = None) -> FloatArray:
        """Return the returns (k,) of parameter vectors (k, P), which must lie in bounds, in the first trial.

        With ``stop_below`` (k,), an episode ends as soon as its running return is below its threshold; what
        is returned for it is then below the threshold, too, and at least what the whole episode would give.
        """
        vectors = _rows(vectors)
        count = len(vectors)
        stop = np.full(count, -np.inf) if stop_below is None else np.array(stop_below, np.float64)
        if stop.shape != (count,):
            raise ValueError(f"stop_below needs one threshold for each of {count} vectors")
        zeros = np.zeros(count, np.int64)
        return self._run(vectors, np.arange(count), zeros, zeros, stop).results[:, 0]

    def traces(self, vectors: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the returns (k,) of parameter vectors (k, P), and the misses (k, E, C, 3) they are made of.

        E trials of C checkpoints, x, y and heading each; a return is the mean over the trials of minus the
        sum of the squares.
        """
        outcomes = self.outcomes(vectors)
        return outcomes.total.mean(axis=1), outcomes.misses

    def outcomes(self, vectors: ArrayLike) -> Outcomes:
        """Return how parameter vectors (k, P), which must lie in bounds, do in every trial."""
        vectors = _rows(vectors)
        if self._nominal:
            tasks = np.arange(len(self.courses))
            trials = np.zeros(len(self.courses), np.int64)
        else:
            trials = np.arange(self._trials.size)
            tasks = (self._first_course + trials) % len(self.courses)
        count = len(vectors)
        queue = self._run(
            vectors,
            np.repeat(np.arange(count), len(trials)),
            np.tile(tasks, count),
            np.tile(trials, count),
            np.full(count * len(trials), -np.inf),
        )
        found = queue.results.reshape(count, len(trials), RESULTS)
        total, error_m, error_rad, moved_m, turned_rad, touches, tracking_m2, tracking_rad2 = (
            found[:, :, i] for i in range(RESULTS)
        )
        touched = touches > 0
        rules = [self.courses[task].parked for task in tasks]
        position, heading, still_m, still_rad = np.array(
            [[rule.position_m, rule.heading_rad, rule.still_m, rule.still_rad] for rule in rules]
        ).T
        parked = (error_m <= position) & (error_rad <= heading) & ~touched
        parked &= (moved_m < still_m) & (turned_rad < still_rad)
        return Outcomes(
            total,
            error_m,
            error_rad,
            moved_m,
            turned_rad,
            touched,
            tracking_m2,
            tracking_rad2,
            parked,
            queue.misses.reshape(count, len(trials), -1, 3),
        )

    def _run(
        self, vectors: FloatArray, vector: IntArray, task: IntArray, trial: IntArray, stop: FloatArray
    ) -> Queue:
        results = np.zeros((len(vector), RESULTS))
        misses = np.zeros((len(vector), *self.checkpoints))
        for ground in range(len(self._grounds)):
            rows = np.flatnonzero(self._ground[task] == ground)
            if rows.size:
                queue = Queue(
                    vectors, vector[rows], task[rows], trial[rows], stop[rows], results[rows], misses[rows]
                )
                race = bool((queue.stop_below > -np.inf).any())
                fleet, lanes = self._team(_width(rows.size, race), ground)
                self.run_queue(lanes, fleet, queue)
                results[rows], misses[rows] = queue.results, queue.misses
        return Queue(vectors, vector, task, trial, stop, results, misses)

    def run_queue(self, lanes: Lanes, fleet: Fleet, queue: Queue) -> None:
        """Run the episodes of a queue."""
        run_episodes(*self.setting, lanes, fleet.arrays, queue)

    @property
    def setting(self) -> tuple[Program, IntArray, Tasks, Trials]:
        """Common arguments of all episodes, in the order of the kernels."""
        return self._program, self._signal_at, self._tasks, self._trials

    @property
    def checkpoints(self) -> tuple[int, int]:
        """C and 3, the shape of an episode's misses."""
        return self._tasks.checkpoints.shape[1:]

    def _team(self, width: int, ground: int) -> tuple[Fleet, Lanes]:
        """Return lanes and rovers of a width for a set of obstacles, built once."""
        if (width, ground) not in self._teams:
            self._teams[width, ground] = self.build_team(width, ground)
        return self._teams[width, ground]

    def build_team(self, width: int, ground: int = 0) -> tuple[Fleet, Lanes]:
        """Return new lanes and rovers of a width, by default for the first course's obstacles."""
        lanes = Lanes(
            parameters=allocate_lanes(self._program, self.policy, width),
            potentials=resting_potentials(self.policy, width),
            observations=np.zeros((len(self._signal_at), width)),
            commands=np.zeros((2, width)),
            poses=np.zeros((3, width)),
            held=np.zeros((2, width)),
            driven=np.zeros((2, width)),
            odometry=np.zeros((3, width)),
            earlier=np.zeros((3, width)),
            episode=np.full(width, IDLE),
            tick=np.zeros(width, np.int64),
            total=np.zeros(width),
            tail=np.zeros((width, int(self._tasks.still.max()) + 1, 3)),
            tracking=np.zeros((2, width)),
            signals=np.zeros(len(SIGNALS)),
        )
        delay_v, delay_omega = self._slowest
        slowest = self.model.model_copy(update={"delay_v_s": delay_v, "delay_omega_s": delay_omega})
        return Fleet([slowest] * width, self._grounds[ground]), lanes


def _rows(vectors: ArrayLike) -> FloatArray:
    return np.ascontiguousarray(np.atleast_2d(np.asarray(vectors, np.float64)))


def _tasks(courses: Sequence[Course], references: Sequence[Reference] | None, model: RoverModel) -> Tasks:
    most = max(course.ticks for course in courses)
    points = max(len(course.checkpoints) for course in courses)
    tasks = Tasks(
        ticks=np.array([course.ticks for course in courses]),
        still=np.array([round(course.parked.still_s / TICK_S) for course in courses]),
        signal=np.zeros((len(courses), most + 1)),
        due=np.full((len(courses), most), -1, np.int64),
        checkpoints=np.zeros((len(courses), points, 3)),
        goal=np.array([course.goal for course in courses]),
        has_reference=references is not None,
        reference=np.zeros((len(courses), most + 1, 5)),
        limits=np.array([model.accel, model.decel, model.alpha, model.alpha_decel]),
    )
    for row, course in enumerate(courses):
        ticks = course.ticks
        tasks.signal[row, : ticks + 1] = [course.start_signal(TICK_S * tick) for tick in range(ticks + 1)]
        tasks.due[row, :ticks] = due_checkpoints(course)
        tasks.checkpoints[row, : len(course.checkpoints)] = [point.pose for point in course.checkpoints]
        if references is not None:
            for tick in range(ticks + 1):
                pose, motion = references[row].tick(tick)
                tasks.reference[row, tick] = *pose, *motion
    return tasks


def _width(count: int, race: bool) -> int:
    """Return how many lanes serve so many episodes.

    Episodes of the same length go in as few rounds as can be, evenly full. In a race they end at all times,
    so fewer lanes with a queue behind them do more than many that stand idle at the end.
    """
    most = min(MOST_LANES, count // RACERS_PER_LANE) if race else MOST_LANES
    rounds = -(-count // max(most, LEAST_LANES))
    return -(-count // rounds)
