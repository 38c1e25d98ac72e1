"""Whole episodes in one kernel: lanes of controllers, each with a rover of a fleet.

``episode_kernel`` makes the kernel for a runner, that of circuits. Episodes wait in a queue
for a free lane. A lane runs its episode on its own clock and takes the next one when that ends, or when its
return falls below its threshold. So all lanes stay busy, and the result of an episode depends neither on its
lane nor on the other episodes. ``rollout.py`` defines an episode; the tests compare the two bit by bit.
"""

from functools import cache
from typing import Any

import numpy as np

from rover_ncp.core.geometry import Pose, Velocity
from rover_ncp.course.hold import HOLD, holds
from rover_ncp.course.signals import signals
from rover_ncp.kernels.jit import inlined_kernel, kernel, without_refcounts
from rover_ncp.robot.dead_zone import STEP, Pulse, clear_of, pulsed
from sim.learn.lanes import IDLE, WARMING_UP, FloatArray, IntArray, Lanes, Queue, Tasks
from sim.world.fleet import (
    FleetArrays,
    advance,
    place,
    push,
    read_pose,
    read_poses,
    send,
    set_delay,
    wrapped,
)
from sim.world.motion_errors import (
    apply_base_errors,
    base_errors,
    dead_reckon,
    odometry_errors,
    push_tick,
    quantise,
)
from sim.world.randomization import Trials
from sim.world.rover import SUBSTEP_S

_signals = kernel(signals)
_base_errors, _odometry_errors = inlined_kernel(base_errors), inlined_kernel(odometry_errors)
_apply_base_errors = kernel(apply_base_errors)
_dead_reckon = kernel(dead_reckon)
_quantise, _push_tick = kernel(quantise), kernel(push_tick)
_holds = kernel(holds)
_clear_of, _pulsed = kernel(clear_of), kernel(pulsed)


@cache
def episode_kernel(start_lane: Any, tick_lanes: Any) -> Any:
    """Return the kernel that runs episodes with a runner's two kernels (``lane_runner.LaneRunner``)."""

    @kernel
    def run_episodes(
        arrays: Any,
        signal_at: IntArray,
        tasks: Tasks,
        trials: Trials,
        lanes: Lanes,
        fleet: FleetArrays,
        queue: Queue,
    ) -> None:
        """Run episodes until a group has ended and a lane is free, or until no episode is left.

        ``arrays`` are the runner's; ``signal_at`` (inputs,) gives the signal of each input.
        """
        arrays, tasks, trials = without_refcounts(arrays), without_refcounts(tasks), without_refcounts(trials)
        lanes, fleet, queue = without_refcounts(lanes), without_refcounts(fleet), without_refcounts(queue)
        episodes, before = lanes.episode, lanes.before
        waiting, ring, left = queue.waiting
        group_size = len(waiting) // len(left)
        running = 0
        for lane in range(len(episodes)):
            running += episodes[lane] != IDLE
        ended_groups = 0
        while True:
            for lane in range(len(episodes)):
                if episodes[lane] == IDLE and ring[1] > 0:
                    episode = waiting[ring[0]]
                    ring[0] = (ring[0] + 1) % len(waiting)
                    ring[1] -= 1
                    start_lane(arrays, lane, queue.vectors[queue.vector[episode]])
                    episodes[lane] = episode
                    start_episode(signal_at, tasks, trials, lanes, fleet, queue, lane)
                    running += 1
            if running == 0:
                return
            for lane in range(len(episodes)):
                before[lane] = episodes[lane]
            tick_lanes(arrays, lanes.observations, lanes.commands)
            pass_commands(tasks, trials, lanes)
            send(fleet, lanes.driven)
            advance(fleet)
            read_poses(fleet, lanes.poses)
            if finish_tick(signal_at, tasks, trials, lanes, fleet, queue) > 0:
                for lane in range(len(episodes)):
                    if episodes[lane] != before[lane]:
                        running -= 1
                        group = before[lane] // group_size
                        left[group] -= 1
                        ended_groups += left[group] == 0
            if ended_groups > 0 and ring[1] == 0 and running < len(episodes):
                return

    return run_episodes


@kernel
def enqueue(
    vectors: FloatArray,
    stop_below: FloatArray,
    residuals: FloatArray,
    episodes: IntArray,
    ring: IntArray,
    left: IntArray,
    group: int,
    added: FloatArray,
    thresholds: FloatArray,
) -> None:
    """Let the episodes of new candidates (n, P) wait, of a group of which none waits or runs.

    The first six are of a queue: to hand it over as a whole takes longer than to fill it.
    """
    first = group * (len(episodes) // len(left))
    for i in range(len(added)):
        episode = first + i
        vectors[episode] = added[i]
        stop_below[episode] = thresholds[i]
        residuals[episode] = 0.0
        episodes[(ring[0] + ring[1]) % len(episodes)] = episode
        ring[1] += 1
    left[group] = len(added)


@kernel
def start_episode(
    signal_at: IntArray,
    tasks: Tasks,
    trials: Trials,
    lanes: Lanes,
    fleet: FleetArrays,
    queue: Queue,
    lane: int,
) -> None:
    """Begin an episode: the trial's rover at its start, no start signal."""
    episode = lanes.episode[lane]
    task, trial = queue.task[episode], queue.trial[episode]
    lanes.task[lane], lanes.trial[lane] = task, trial
    lanes.tick[lane] = WARMING_UP
    lanes.total[lane] = 0.0
    lanes.holds[lane] = False
    for axis in range(3):
        lanes.odometry[axis, lane] = lanes.earlier[axis, lane] = trials.start[trial, axis]
    for axis in range(2):
        lanes.held[axis, lane] = lanes.tracking[axis, lane] = 0.0
        for part in range(3):
            lanes.pulses[axis, part, lane] = 0.0
        faster, slower = trials.acceleration[trial, axis], trials.acceleration[trial, axis + 2]
        gain = trials.turning[trial, 0] if axis == 1 else 1.0
        fleet.rise[axis, lane] = (tasks.limits[2 * axis] * faster) * SUBSTEP_S * gain
        fleet.fall[axis, lane] = (tasks.limits[2 * axis + 1] * slower) * SUBSTEP_S * gain
        fleet.turning[axis, lane] = trials.turning[trial, axis]
    set_delay(fleet, lane, trials.delay[trial, 0], trials.delay[trial, 1])
    put_at_start(trials, lanes, fleet, trial, lane)
    observe(signal_at, tasks, trials, lanes, task, trial, lane, 0, 0.0)


@inlined_kernel
def put_at_start(trials: Trials, lanes: Lanes, fleet: FleetArrays, trial: int, lane: int) -> None:
    """Place the rover where its trial starts."""
    start = trials.start[trial]
    place(fleet, lane, start[0], start[1], start[2])
    for axis in range(3):
        lanes.poses[axis, lane] = lanes.tail[lane, 0, axis] = start[axis]
    lanes.latest[lane] = 0


@inlined_kernel
def observe(
    signal_at: IntArray,
    tasks: Tasks,
    trials: Trials,
    lanes: Lanes,
    task: int,
    trial: int,
    lane: int,
    tick: int,
    signal: float,
) -> None:
    """Write a lane's observation at the start of a tick: the noisy pose of odometry and the rest."""
    seen, row = lanes.signals, tasks.reference[task, tick]
    for axis in range(3):
        seen[axis] = lanes.odometry[axis, lane]
        if not trials.exact:
            old = trials.age[trial, tick] * (lanes.odometry[axis, lane] - lanes.earlier[axis, lane])
            seen[axis] += trials.noise[trial, tick, axis] - old
    if not trials.exact:
        seen[2] = wrapped(seen[2])
        goal, (position_m, heading_rad) = tasks.goal[task], tasks.near[task]
        away_m = np.hypot(seen[0] - goal[0], seen[1] - goal[1])
        turned = abs(wrapped(seen[2] - goal[2]))
        lanes.near_goal[lane] = away_m <= position_m and turned <= heading_rad
    pose = Pose(seen[0], seen[1], seen[2])
    if tasks.has_reference:
        values = _signals(pose, signal, (Pose(row[0], row[1], row[2]), Velocity(row[3], row[4])))
    else:
        values = _signals(pose, signal, None)
    for i in range(len(values)):
        seen[i] = values[i]
    for i in range(len(signal_at)):
        lanes.observations[i, lane] = seen[signal_at[i]]


@inlined_kernel
def pass_commands(tasks: Tasks, trials: Trials, lanes: Lanes) -> None:
    """Bring the commands to the bases, but for those lost; rovers stay whose circuit warms up or is idle."""
    commands, held, episode, tick, rows = lanes.commands, lanes.held, lanes.episode, lanes.tick, lanes.trial
    for lane in range(len(episode)):
        if episode[lane] == IDLE or tick[lane] == WARMING_UP:
            lanes.driven[0, lane] = lanes.driven[1, lane] = 0.0
            continue
        trial = rows[lane]
        base = _base_errors(trials, trial)
        min_v, min_omega = (
            _clear_of(base.dead_band_v, STEP.v),
            _clear_of(base.dead_band_omega, STEP.omega),
        )
        v, omega = commands[0, lane], commands[1, lane]
        if not trials.exact and tick[lane] >= tasks.hold[lanes.task[lane]]:
            hold = Velocity(max(HOLD.v, min_v), max(HOLD.omega, min_omega))
            lanes.holds[lane] = _holds(v, omega, hold, lanes.near_goal[lane], lanes.holds[lane])
        if lanes.holds[lane]:
            v = omega = 0.0
        v, omega = send_pulse(lanes, 0, lane, v, min_v), send_pulse(lanes, 1, lane, omega, min_omega)
        if not trials.lost[trial, np.uint64(tick[lane])]:
            held[0, lane] = _quantise(v, trials.step[0])
            held[1, lane] = _quantise(omega, trials.step[1])
        before = lanes.driven[0, lane], lanes.driven[1, lane]
        motion = _apply_base_errors(held[0, lane], held[1, lane], base, before)
        lanes.driven[0, lane], lanes.driven[1, lane] = motion


@inlined_kernel
def send_pulse(lanes: Lanes, axis: int, lane: int, wanted: float, least: float) -> float:
    """Return the command of a driver that knows the base's dead band."""
    if least == 0.0:
        return wanted
    kept = lanes.pulses
    pulse = _pulsed(wanted, least, Pulse(kept[axis, 0, lane], kept[axis, 1, lane], int(kept[axis, 2, lane])))
    kept[axis, 0, lane], kept[axis, 1, lane], kept[axis, 2, lane] = pulse.sent, pulse.owed, float(pulse.ticks)
    return float(pulse.sent)


@inlined_kernel
def finish_tick(
    signal_at: IntArray, tasks: Tasks, trials: Trials, lanes: Lanes, fleet: FleetArrays, queue: Queue
) -> int:
    """Judge what a tick led to, and observe; return how many episodes ended."""
    # Local names: numba counts references whenever an array is taken out of a tuple.
    episodes, ticks, total, poses, residuals = (
        lanes.episode,
        lanes.tick,
        lanes.total,
        lanes.poses,
        queue.residuals,
    )
    due, checkpoints, reference = tasks.due, tasks.checkpoints, tasks.reference
    ended = 0
    for lane in range(len(episodes)):
        episode = episodes[lane]
        if episode == IDLE:
            continue
        task, trial, before = lanes.task[lane], lanes.trial[lane], ticks[lane]
        ticks[lane] = before + 1
        if before == WARMING_UP:
            # The rover stood still, but for what the last contact of its last episode left to correct.
            put_at_start(trials, lanes, fleet, trial, lane)
            observe(signal_at, tasks, trials, lanes, task, trial, lane, 0, tasks.signal[task, 0])
            continue
        now, next_tick = np.uint64(before), np.uint64(before + 1)
        if due[task, now] >= 0:
            target = np.uint64(due[task, now])
            dx = poses[0, lane] - checkpoints[task, target, 0]
            dy = poses[1, lane] - checkpoints[task, target, 1]
            dtheta = wrapped(poses[2, lane] - checkpoints[task, target, 2])
            total[lane] -= dx * dx + dy * dy + dtheta * dtheta
            residuals[episode, target, 0] = dx
            residuals[episode, target, 1] = dy
            residuals[episode, target, 2] = dtheta
        if tasks.has_reference:
            where = reference[task, next_tick]
            dx, dy = poses[0, lane] - where[0], poses[1, lane] - where[1]
            dtheta = wrapped(poses[2, lane] - where[2])
            lanes.tracking[0, lane] += dx * dx + dy * dy
            lanes.tracking[1, lane] += dtheta * dtheta
        keep_pose(trials, lanes, fleet, trial, lane, next_tick, tasks.ticks[task])
        if before + 1 == tasks.ticks[task] or total[lane] < queue.stop_below[episode]:
            conclude(tasks, lanes, fleet, task, lane, queue.results[episode])
            episodes[lane] = IDLE
            ended += 1
        else:
            signal = tasks.signal[task, next_tick]
            observe(signal_at, tasks, trials, lanes, task, trial, lane, next_tick, signal)
    return ended


@inlined_kernel
def keep_pose(
    trials: Trials, lanes: Lanes, fleet: FleetArrays, trial: int, lane: int, ticks_done: int, ticks: int
) -> None:
    """Move odometry by a tick, push the rover if that is due, and keep its pose; a course has ``ticks``."""
    poses, odometry, tail, latest = lanes.poses, lanes.odometry, lanes.tail, lanes.latest
    sees_pose = trials.exact or trials.sensors[1]
    if not trials.exact:
        for axis in range(3):
            lanes.earlier[axis, lane] = odometry[axis, lane]
    if not sees_pose:
        before = tail[lane, latest[lane]]
        odometry[0, lane], odometry[1, lane], odometry[2, lane] = _dead_reckon(
            Pose(odometry[0, lane], odometry[1, lane], odometry[2, lane]),
            Pose(before[0], before[1], before[2]),
            Pose(poses[0, lane], poses[1, lane], poses[2, lane]),
            _odometry_errors(trials, trial),
        )
    if not trials.exact and ticks_done == _push_tick(trials.bump[trial, 0], ticks):
        bump(trials, lanes, fleet, trial, lane)
    row = latest[lane] + np.uint64(1)
    if row == tail.shape[1]:
        row = np.uint64(0)
    latest[lane] = row
    for axis in range(3):
        if sees_pose:
            odometry[axis, lane] = poses[axis, lane]
        tail[lane, row, axis] = poses[axis, lane]


@kernel
def bump(trials: Trials, lanes: Lanes, fleet: FleetArrays, trial: int, lane: int) -> None:
    """Push the rover without a turn of its wheels."""
    _, x, y, theta = trials.bump[trial]
    push(fleet, lane, x, y, theta)
    read_pose(fleet, lanes.poses, lane)


@kernel
def conclude(
    tasks: Tasks, lanes: Lanes, fleet: FleetArrays, task: int, lane: int, results: FloatArray
) -> None:
    """Write what an episode ends in (``RESULTS``); of one that is stopped early only the return counts."""
    tail, goal, ticks = lanes.tail, tasks.goal[task], lanes.tick[lane]
    length, latest = tail.shape[1], int(lanes.latest[lane])
    end = tail[lane, latest]
    moved, turned = 0.0, 0.0
    for back in range(min(tasks.still[task], ticks) + 1):
        pose = tail[lane, (latest - back) % length]
        moved = max(moved, np.hypot(pose[0] - end[0], pose[1] - end[1]))
        turned = max(turned, abs(wrapped(pose[2] - end[2])))
    results[0] = lanes.total[lane]
    results[1] = np.hypot(end[0] - goal[0], end[1] - goal[1])
    results[2] = abs(wrapped(end[2] - goal[2]))
    results[3] = moved
    results[4] = turned
    results[5] = fleet.touched[lane]
    results[6] = lanes.tracking[0, lane] / ticks
    results[7] = lanes.tracking[1, lane] / ticks
