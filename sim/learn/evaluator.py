"""The evaluator: scores parameter vectors by episodes, on one course or several, with or without trials.

    stream = evaluator.stream(1)
    stream.submit(0, batch)
    [(_, scores)] = stream.collect()
    batch = search.send(scores)

A return only falls, because no reward is positive. An episode whose running return is below its threshold may
therefore be truncated without any effect on a comparison with that threshold.
"""

from collections.abc import Callable, Sequence
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rover_ncp.circuit.compiled import Circuits, make_circuits
from rover_ncp.circuit.policy import Policy
from rover_ncp.circuit.rover_interface import RoverInterface
from rover_ncp.course.course import TICK_S, Course
from rover_ncp.course.hold import hold_from_s
from rover_ncp.course.reference import Reference, plan_reference
from rover_ncp.course.scoring import due_checkpoints
from rover_ncp.native.core import Axes, FloatArray, bound_episodes, bound_submit, row_addresses
from sim.learn.search import Batch, Scores
from sim.world.described import default_rover
from sim.world.fleet import Fleet
from sim.world.pymunk_rover import require_free_start
from sim.world.randomization import Trials, nominal_trials
from sim.world.rover import SUBSTEP_S, RoverModel

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_MAX_LANES = 24
"""More gain nothing: all numbers should stay in a core's first cache."""

_STREAM_LANES = 8
"""One vector; with more, lanes idle while agents wait for their last episode."""
_MIN_ROOM = 100
"""Candidates that a search may submit at once, or as many as it has parameters."""

_NOT_FINITE = "a parameter is not finite"

IDLE = -1
WARMING_UP = -1

RESULTS = 8
"""Numbers an episode ends in, in this order: return; distance (m) and angle (rad) to the goal; the farthest
that pose and heading were, in the time to be still, from where they ended (m, rad); touched (0 or 1); means
over all ticks of the squared distance (m²) and angle (rad²) to the reference."""


class Tasks(NamedTuple):
    """Courses, of up to ``ticks`` ticks, up to ``still`` of them to be still."""

    ticks: Annotated[IntArray, Axes("courses", below="ticks+1")]
    still: Annotated[IntArray, Axes("courses")]
    hold: Annotated[IntArray, Axes("courses")]
    """The first tick in which a rover may hold."""
    near: Annotated[FloatArray, Axes("courses", 2)]
    """Position in m and heading in rad within which it may."""
    signal: Annotated[FloatArray, Axes("courses", "ticks+1")]
    """Start signal at the start of each tick."""
    due: Annotated[IntArray, Axes("courses", "ticks", below="checkpoints", lowest=-1)]
    """Checkpoint judged at the end of each tick, or -1."""
    checkpoints: Annotated[FloatArray, Axes("courses", "checkpoints", 3)]
    """Poses, the last one the goal."""
    goal: Annotated[FloatArray, Axes("courses", 3)]
    has_reference: bool
    reference: Annotated[FloatArray, Axes("courses", "ticks+1", 5)]
    """x, y, theta, v, omega at the start of each tick; 0 where no policy asks for it."""
    limits: Annotated[FloatArray, Axes(4)]
    """The model's accel, decel, alpha, alpha_decel."""


class Lanes(NamedTuple):
    """L lanes at work, beside the circuits and the fleet."""

    observations: Annotated[FloatArray, Axes("inputs", "lanes")]
    commands: Annotated[FloatArray, Axes(2, "lanes")]
    poses: Annotated[FloatArray, Axes(3, "lanes")]
    held: Annotated[FloatArray, Axes(2, "lanes")]
    driven: Annotated[FloatArray, Axes(2, "lanes")]
    """The command that arrived last, and the motion that the base makes of it."""
    pulses: Annotated[FloatArray, Axes(2, 3, "lanes")]
    """The driver's ``Pulse`` of v and of omega."""
    near_goal: Annotated[BoolArray, Axes("lanes")]
    holds: Annotated[BoolArray, Axes("lanes")]
    """Whether the observed pose is near the goal, and whether the rover holds."""
    odometry: Annotated[FloatArray, Axes(3, "lanes")]
    earlier: Annotated[FloatArray, Axes(3, "lanes")]
    """The pose by odometry, heading not wrapped, now and a tick ago."""
    episode: Annotated[IntArray, Axes("lanes", below="episodes", lowest=IDLE)]
    task: Annotated[IntArray, Axes("lanes", below="courses")]
    trial: Annotated[IntArray, Axes("lanes", below="trials")]
    """Of its episode."""
    tick: Annotated[IntArray, Axes("lanes", below="ticks+1", lowest=WARMING_UP)]
    total: Annotated[FloatArray, Axes("lanes")]
    """Running return."""
    tail: Annotated[FloatArray, Axes("lanes", "poses_kept", 3)]
    """Ring of the last poses, one more than the ticks to be still."""
    latest: Annotated[IntArray, Axes("lanes", below="poses_kept")]
    """Where the last of them is."""
    tracking: Annotated[FloatArray, Axes(2, "lanes")]
    """Running sums."""
    before: Annotated[IntArray, Axes("lanes")]
    """Work: the lanes' episodes before a tick."""


class Waiting(NamedTuple):
    """The episodes of a queue in groups of equal size, group by group."""

    submitted: Annotated[IntArray, Axes("groups", below="episodes+1")]
    begun: Annotated[IntArray, Axes("groups", below="episodes+1")]
    left: Annotated[IntArray, Axes("groups")]
    """Episodes of each group's last batch: all, those that a lane took, and those that have not ended."""
    begun_in_all: Annotated[IntArray, Axes("groups")]
    """Episodes of all its batches that a lane took."""


class Queue(NamedTuple):
    """Episodes and their results."""

    vectors: Annotated[FloatArray, Axes("vectors", "parameters")]
    vector: Annotated[IntArray, Axes("episodes", below="vectors")]
    task: Annotated[IntArray, Axes("episodes", below="courses")]
    trial: Annotated[IntArray, Axes("episodes", below="trials")]
    stop_below: Annotated[FloatArray, Axes("episodes")]
    """An episode is truncated as soon as its running return is below."""
    results: Annotated[FloatArray, Axes("episodes", RESULTS)]
    residuals: Annotated[FloatArray, Axes("episodes", "checkpoints", 3)]
    """x, y and heading from each checkpoint when it was judged; 0 where none was."""
    waiting: Waiting


class Outcomes(NamedTuple):
    """How episodes ended, each array (candidates, trials); m, rad, and their squares."""

    total: FloatArray
    """Returns."""
    error_m: FloatArray
    error_rad: FloatArray
    moved_m: FloatArray
    turned_rad: FloatArray
    """The most in the time to be still."""
    touched: BoolArray
    tracking_m2: FloatArray
    tracking_rad2: FloatArray
    """Mean squared distance and angle to the reference; of no meaning without one."""
    parked: BoolArray


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
        ticks = int(self._tasks.ticks.max())
        self.change_trials(trials or nominal_trials(self.model, ticks, len(courses)))

    def change_trials(self, trials: Trials, first_course: int = 0) -> None:
        """Drive other trials from now on, trial i on course ``first_course`` + i modulo their number."""
        if trials.noise.shape[1] <= int(self._tasks.ticks.max()):
            raise ValueError(f"trials of {trials.noise.shape[1] - 1} ticks are too short for the courses")
        self._trials, self._first_course = trials, first_course
        delays = tuple(SUBSTEP_S * trials.delay.max(axis=0))
        longest = tuple(map(max, delays, self._delays))
        if longest != self._delays:
            # Commands wait longer than the fleets made so far have room for.
            self._delays, self._lane_sets = longest, {}

    def returns(self, vectors: ArrayLike) -> FloatArray:
        """Return the returns (k,) of parameter vectors (k, P) in bounds: means over the trials or courses."""
        return np.asarray(self.outcomes(vectors).total.mean(axis=1))

    def outcomes(self, vectors: ArrayLike) -> Outcomes:
        """Return how the episodes of parameter vectors (k, P) in bounds end."""
        tasks, found = self._drive(vectors)
        total, error_m, error_rad, moved_m, turned_rad, touches, away_m2, away_rad2 = np.moveaxis(found, 2, 0)
        rules = [self.courses[task].parked for task in tasks]
        position, heading, still_m, still_rad = np.array(
            [[rule.position_m, rule.heading_rad, rule.still_m, rule.still_rad] for rule in rules]
        ).T
        parked = (error_m <= position) & (error_rad <= heading) & (moved_m < still_m)
        parked &= (turned_rad < still_rad) & (touches == 0)
        return Outcomes(
            total, error_m, error_rad, moved_m, turned_rad, touches > 0, away_m2, away_rad2, parked
        )

    def stream(self, agents: int) -> "Stream":
        """Return a stream for so many agents. Raises ValueError for several courses or trials."""
        if len(self.courses) > 1 or self._trials.size > 1:
            raise ValueError("a stream drives one trial on one course")
        lane_set, size = self._build_lanes(_STREAM_LANES, 0), self._policy.layout().size
        vectors = np.zeros((agents * max(_MIN_ROOM, size), size))
        none = np.zeros(len(vectors), np.int64)
        waiting = Waiting(*np.zeros((4, agents), np.int64))
        queue = self._build_queue(vectors, waiting, vector=np.arange(len(vectors)), task=none, trial=none)
        return Stream(queue, lane_set, self._bind(lane_set, queue))

    def _drive(self, vectors: ArrayLike) -> tuple[IntArray, FloatArray]:
        """Return the courses (E,) and results (k, E, RESULTS) of vectors (k, P)."""
        rows = np.ascontiguousarray(np.atleast_2d(np.asarray(vectors, np.float64)))
        if not np.isfinite(rows).all():
            raise ValueError(_NOT_FINITE)
        trials = np.arange(self._trials.size)
        tasks = (self._first_course + trials) % len(self.courses)
        results = np.zeros((len(rows), len(tasks), RESULTS))
        for ground in range(len(self._grounds)):
            (chosen,) = np.nonzero(self._ground[tasks] == ground)
            count = len(rows) * len(chosen)
            if not count:
                continue
            queue = self._build_queue(
                rows,
                Waiting(np.array([count]), np.array([0]), np.array([count]), np.array([0])),
                vector=np.repeat(np.arange(len(rows)), len(chosen)),
                task=np.tile(tasks[chosen], len(rows)),
                trial=np.tile(trials[chosen], len(rows)),
            )
            rounds = -(-count // _MAX_LANES)
            width = -(-count // rounds)  # all rounds are evenly full
            if (width, ground) not in self._lane_sets:
                self._lane_sets[width, ground] = self._build_lanes(width, ground)
            self._bind(self._lane_sets[width, ground], queue)()
            results[:, chosen] = queue.results.reshape(len(rows), len(chosen), RESULTS)
        return tasks, results

    def _build_queue(
        self, vectors: FloatArray, waiting: Waiting, *, vector: IntArray, task: IntArray, trial: IntArray
    ) -> Queue:
        """Return a queue of episodes (E,), none of which is truncated."""
        return Queue(
            vectors=vectors,
            vector=vector,
            task=task,
            trial=trial,
            stop_below=np.full(len(vector), -np.inf),
            results=np.zeros((len(vector), RESULTS)),
            residuals=np.zeros((len(vector), *self._tasks.checkpoints.shape[1:])),
            waiting=waiting,
        )

    def _bind(self, lane_set: _LaneSet, queue: Queue) -> Callable[[], object]:
        """Return what runs a queue, as long as the lanes exist: it has their addresses alone."""
        return bound_episodes(
            lane_set.circuits,
            self._signal_at,
            tasks=self._tasks,
            trials=self._trials,
            lanes=lane_set.lanes,
            fleet=lane_set.fleet.arrays,
            queue=queue,
        )

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

    In batches, lanes would idle until the last episode of a batch ends. Here a free lane takes a waiting
    episode of the agent that is behind the others, and an agent gets its answer as soon as its own episodes
    have ended. The returns are those of ``Evaluator.returns``.
    """

    def __init__(self, queue: Queue, lane_set: _LaneSet, run: Callable[[], object]) -> None:
        self._queue, self._lane_set, self._run_queue = queue, lane_set, run
        self._submit = bound_submit(queue)
        agents = len(queue.waiting.left)
        self._room, self._parameters = len(queue.vectors) // agents, queue.vectors.shape[1]
        self._submitted = [0] * agents

    def submit(self, agent: int, batch: Batch) -> None:
        """Let the episodes of a batch wait for lanes; the agent has none that do.

        Raises ValueError or TypeError for arrays that are not those of a batch.
        """
        count = len(batch.vectors)
        if not 0 <= agent < len(self._submitted) or self._submitted[agent] or not 0 < count <= self._room:
            raise ValueError(f"agent {agent} cannot submit {count} candidates now")
        vectors = row_addresses(batch.vectors, count, self._parameters)
        if self._submit(agent, count, vectors[0], row_addresses(batch.to_beat, count)[0]):
            raise ValueError(_NOT_FINITE)
        self._submitted[agent] = count

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
