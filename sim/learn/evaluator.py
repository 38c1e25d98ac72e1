"""The evaluator: scores parameter vectors by episodes, on one course or several, with or without trials.

    stream = evaluator.stream(1)
    stream.submit(0, batch)
    [(_, scores)] = stream.collect()
    batch = search.send(scores)

A return only falls, because no reward is positive. An episode whose running return is below its threshold may
therefore be truncated without any effect on a comparison with that threshold.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.circuit.compiled import Circuits, make_circuits
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.hold import hold_from_s
from rover_ncp.course.reference import Reference, plan_reference
from rover_ncp.course.scoring import due_checkpoints
from rover_ncp.native.core import bound_episodes
from sim.learn.lanes import IDLE, RESULTS, FloatArray, IntArray, Lanes, Queue, Tasks, Waiting
from sim.learn.search.strategies import Batch, Scores
from sim.world.described import default_rover
from sim.world.fleet import Fleet
from sim.world.pymunk_rover import require_free_start
from sim.world.randomization import Trials, nominal_trials
from sim.world.rover import SUBSTEP_S, RoverModel

_MAX_LANES = 24
"""More gain nothing: all numbers should stay in a core's first cache."""

STREAM_LANES = 8
"""One vector; with more, lanes idle while agents wait for their last episode."""
_MIN_ROOM = 100
"""Candidates that a search may submit at once, or as many as it has parameters."""


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


class _LaneSet(NamedTuple):
    """Lanes, their circuits and their rovers, for one set of obstacles."""

    circuits: Circuits
    lanes: Lanes
    fleet: Fleet


class Evaluator:
    """Scores parameter vectors of one policy's circuit. One thread at a time.

    With ``trials``, trial i is driven on course i modulo the number of courses; without, each course once as
    the model is. References are planned where the policy observes them and none are given.

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
        interface = RoverInterface(policy)
        courses = [course] if isinstance(course, Course) else list(course)
        self.courses, self.model = courses, model or default_rover()
        for each in courses:
            require_free_start(self.model, each)
        # Lanes are built for one set of obstacles, and drive the courses that have it.
        self._grounds = list(dict.fromkeys(each.obstacles for each in courses))
        self._ground = np.array([self._grounds.index(each.obstacles) for each in courses])
        if references is None and interface.needs_reference:
            references = [plan_reference(each) for each in courses]
        self._policy = policy
        self._signal_at = np.array(interface.places)
        self._tasks = _tasks(courses, references, self.model)
        self._lane_sets: dict[tuple[int, int], _LaneSet] = {}
        self._delays = (0.0, 0.0)
        self.change_trials(trials or nominal_trials(self.model, int(self._tasks.ticks.max())))
        self._nominal = trials is None

    def change_trials(self, trials: Trials, first_course: int = 0) -> None:
        """Drive other trials from now on, trial i on course ``first_course`` + i modulo their number."""
        if trials.noise.shape[1] <= int(self._tasks.ticks.max()):
            raise ValueError(f"trials of {trials.noise.shape[1] - 1} ticks are too short for the courses")
        self._nominal, self._trials, self._first_course = False, trials, first_course
        delays = tuple(SUBSTEP_S * trials.delay.max(axis=0))
        longest = tuple(map(max, delays, self._delays))
        if longest != self._delays:
            # Commands wait longer than the fleets made so far have room for.
            self._delays, self._lane_sets = longest, {}

    def returns(self, vectors: ArrayLike) -> FloatArray:
        """Return the returns (k,) of parameter vectors (k, P) in bounds: means over the trials or courses."""
        mean: FloatArray = self._drive(vectors)[1][:, :, 0].mean(axis=1)
        return mean

    def outcomes(self, vectors: ArrayLike) -> Outcomes:
        """Return how the episodes of parameter vectors (k, P) in bounds end."""
        tasks, found = self._drive(vectors)
        total, error_m, error_rad, moved_m, turned_rad, touches, tracking_m2, tracking_rad2 = np.moveaxis(
            found, 2, 0
        )
        touched = touches > 0
        rules = [self.courses[task].parked for task in tasks]
        position, heading, still_m, still_rad = np.array(
            [[rule.position_m, rule.heading_rad, rule.still_m, rule.still_rad] for rule in rules]
        ).T
        parked = (error_m <= position) & (error_rad <= heading) & ~touched
        parked &= (moved_m < still_m) & (turned_rad < still_rad)
        return Outcomes(
            total=total,
            error_m=error_m,
            error_rad=error_rad,
            moved_m=moved_m,
            turned_rad=turned_rad,
            touched=touched,
            tracking_m2=tracking_m2,
            tracking_rad2=tracking_rad2,
            parked=parked,
        )

    def stream(self, agents: int) -> "Stream":
        """Return a stream for so many agents. Raises ValueError for several courses or trials."""
        if len(self.courses) > 1 or self._trials.size > 1:
            raise ValueError("a stream drives one trial on one course")
        lane_set = self._build_lanes(STREAM_LANES, 0)
        size, checkpoints = self._policy.layout().size, self._tasks.checkpoints.shape[1]
        return Stream(agents, size, checkpoints, lambda queue: self._bind(lane_set, queue))

    def _drive(self, vectors: ArrayLike) -> tuple[IntArray, FloatArray]:
        """Return the courses (E,) and results (k, E, RESULTS) of vectors (k, P)."""
        rows = np.ascontiguousarray(np.atleast_2d(np.asarray(vectors, np.float64)))
        _require_finite(rows)
        if self._nominal:
            tasks = np.arange(len(self.courses))
            trials = np.zeros(len(tasks), np.int64)
        else:
            trials = np.arange(self._trials.size)
            tasks = (self._first_course + trials) % len(self.courses)
        results = np.zeros((len(rows), len(tasks), RESULTS))
        for ground in range(len(self._grounds)):
            (chosen,) = np.nonzero(self._ground[tasks] == ground)
            count = len(rows) * len(chosen)
            if not count:
                continue
            queue = Queue(
                vectors=rows,
                vector=np.repeat(np.arange(len(rows)), len(chosen)),
                task=np.tile(tasks[chosen], len(rows)),
                trial=np.tile(trials[chosen], len(rows)),
                stop_below=np.full(count, -np.inf),
                results=np.zeros((count, RESULTS)),
                residuals=np.zeros((count, *self._tasks.checkpoints.shape[1:])),
                waiting=Waiting(np.arange(count), np.array([0, count]), np.array([count])),
            )
            width = _width(count)
            if (width, ground) not in self._lane_sets:
                self._lane_sets[width, ground] = self._build_lanes(width, ground)
            self._bind(self._lane_sets[width, ground], queue)()
            results[:, chosen] = queue.results.reshape(len(rows), len(chosen), RESULTS)
        return tasks, results

    def _bind(self, lane_set: _LaneSet, queue: Queue) -> Callable[[], None]:
        """Return what runs a queue; it keeps the rovers, of which the library has no more than addresses."""
        run = bound_episodes(
            self._signal_at,
            circuits=lane_set.circuits,
            tasks=self._tasks,
            trials=self._trials,
            lanes=lane_set.lanes,
            fleet=lane_set.fleet.arrays,
            queue=queue,
        )

        def run_queue(fleet: Fleet = lane_set.fleet) -> None:
            run()

        return run_queue

    def _build_lanes(self, width: int, ground: int) -> _LaneSet:
        lanes = Lanes(
            observations=np.zeros((len(self._signal_at), width)),
            commands=np.zeros((2, width)),
            poses=np.zeros((3, width)),
            held=np.zeros((2, width)),
            driven=np.zeros((2, width)),
            pulses=np.zeros((2, 3, width)),
            near_goal=np.zeros(width, np.bool_),
            holds=np.zeros(width, np.bool_),
            odometry=np.zeros((3, width)),
            earlier=np.zeros((3, width)),
            episode=np.full(width, IDLE),
            task=np.zeros(width, np.int64),
            trial=np.zeros(width, np.int64),
            tick=np.zeros(width, np.int64),
            total=np.zeros(width),
            tail=np.zeros((width, int(self._tasks.still.max()) + 1, 3)),
            latest=np.zeros(width, np.int64),
            tracking=np.zeros((2, width)),
            before=np.full(width, IDLE),
        )
        delay_v, delay_omega = self._delays
        slowest = self.model.model_copy(update={"delay_v_s": delay_v, "delay_omega_s": delay_omega})
        fleet = Fleet([slowest] * width, self._grounds[ground])
        return _LaneSet(make_circuits(self._policy, width), lanes, fleet)


class Stream:
    """Episodes of many agents that share lanes without a pause.

    In batches, lanes would idle until the last episode of a batch ends. Here a free lane takes the next
    waiting episode of any agent, and an agent gets its answer as soon as its own episodes have ended. The
    returns are those of ``Evaluator.returns``.
    """

    def __init__(
        self, agents: int, size: int, checkpoints: int, bind: Callable[[Queue], Callable[[], None]]
    ) -> None:
        self._room = max(_MIN_ROOM, size)
        episodes = agents * self._room
        zeros = np.zeros(episodes, np.int64)
        self._queue = Queue(
            vectors=np.zeros((episodes, size)),
            vector=np.arange(episodes),
            task=zeros,
            trial=zeros,
            stop_below=np.zeros(episodes),
            results=np.zeros((episodes, RESULTS)),
            residuals=np.zeros((episodes, checkpoints, 3)),
            waiting=Waiting(zeros.copy(), np.zeros(2, np.int64), np.zeros(agents, np.int64)),
        )
        self._run_queue = bind(self._queue)
        self._submitted = [0] * agents

    def submit(self, agent: int, batch: Batch) -> None:
        """Let the episodes of a batch wait for lanes; the agent has none that do."""
        count, queue = len(batch.vectors), self._queue
        if self._submitted[agent] or not 0 < count <= self._room or len(batch.to_beat) != count:
            raise ValueError(f"agent {agent} cannot submit {count} candidates now")
        _require_finite(batch.vectors)
        first, (episodes, ring, left) = agent * self._room, queue.waiting
        queue.vectors[first : first + count] = batch.vectors
        queue.stop_below[first : first + count] = batch.to_beat
        queue.residuals[first : first + count] = 0.0
        end = int(ring.sum())
        episodes[np.arange(end, end + count) % len(episodes)] = np.arange(first, first + count)
        ring[1] += count
        left[agent] = self._submitted[agent] = count

    def collect(self) -> list[tuple[int, Scores]]:
        """Return each agent whose batch has ended, and its scores; none if no candidates wait.

        The arrays of the scores may change when the agent submits again.
        """
        self._run_queue()
        answers = []
        for agent, left in enumerate(self._queue.waiting.left.tolist()):
            count = self._submitted[agent]
            if left or not count:
                continue
            own = slice(agent * self._room, agent * self._room + count)
            self._submitted[agent] = 0
            answers.append((agent, Scores(self._queue.results[own, 0], self._queue.residuals[own])))
        return answers


def _require_finite(vectors: FloatArray) -> None:
    if not np.isfinite(vectors).all():
        raise ValueError("a parameter is not finite")


def _tasks(courses: Sequence[Course], references: Sequence[Reference] | None, model: RoverModel) -> Tasks:
    most = max(course.ticks for course in courses)
    points = max(len(course.checkpoints) for course in courses)
    tasks = Tasks(
        ticks=np.array([course.ticks for course in courses]),
        still=np.array([round(course.parked.still_s / TICK_S) for course in courses]),
        hold=np.array([_hold_tick(course) for course in courses]),
        near=np.array([(course.parked.position_m, course.parked.heading_rad) for course in courses]),
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


def _hold_tick(course: Course) -> int:
    """Return the first tick in which a rover on the course may hold."""
    return next(tick for tick in range(course.ticks + 1) if TICK_S * tick > hold_from_s(course))


def _width(count: int) -> int:
    """Return how many lanes serve so many episodes: in as few rounds as can be, evenly full."""
    rounds = -(-count // _MAX_LANES)
    return -(-count // rounds)
