// Whole episodes: lanes of circuits, each with a rover of a fleet.
//
// Episodes wait in a queue for a free lane. A lane runs its episode on its own clock and takes another one when that
// ends, or when its return falls below its threshold. So all lanes stay busy, and the result of an episode depends
// neither on its lane nor on the other episodes. sim/learn/rollout.py defines an episode, with the same bits.

#include "circuit.h"
#include "fleet.h"

extern "C" {
double cos(double);
double sin(double);
double hypot(double, double);
double floor(double);
double fabs(double);
double copysign(double, double);
}

namespace {

using Flags = Array<bool, 1>;
constexpr int64_t IDLE = -1, WARMING_UP = -1, NONE = -1;
constexpr double TICK_S = 0.1;
constexpr int SIGNALS = 9;  // of rover_ncp/course/signals.py, in its order

struct Pose {
    double x, y, theta;
};

struct Velocity {
    double v, omega;
};

// The fields of the named tuples of sim/learn and sim/world, which document them.
struct Tasks {
    Indices ticks, still, hold;
    Matrix near, signal;
    IndexMatrix due;
    Cube checkpoints;
    Matrix goal;
    int64_t has_reference;
    Cube reference;
    Doubles limits;
};

struct Trials {
    int64_t exact, measures_turn, measures_pose;
    Matrix start, acceleration;
    IndexMatrix delay;
    Matrix gain, odometry;
    Doubles wheel_mismatch, slip, drift;
    Matrix turning, bump;
    Cube noise;
    Matrix age;
    Array<bool, 2> lost;
    Doubles step;
    Matrix motors;
};

struct Lanes {
    Matrix observations, commands, poses, held, driven;
    Cube pulses;
    Flags near_goal, holds;
    Matrix odometry, earlier;
    Indices episode, task, trial, tick;
    Doubles total;
    Cube tail;
    Indices latest;
    Matrix tracking;
    Indices before;
};

struct Waiting {
    Indices submitted, begun, left, begun_in_all;
};

struct Queue {
    Matrix vectors;
    Indices vector, task, trial;
    Doubles stop_below;
    Matrix results;
    Cube residuals;
    Waiting waiting;

    int64_t group_size() const { return results.shape[0] / waiting.left.shape[0]; }
};

constexpr double RESTING_MV = -70.0;  // rover_ncp/circuit/circuit.py
constexpr Velocity HOLD = {0.004, 0.017453292519943295};        // rover_ncp/course/hold.py
constexpr Velocity SPEED_STEP = {0.001, 0.017453292519943295};  // rover_ncp/robot/dead_zone.py, as all of Pulse
constexpr double PULSE_MARGIN = 0.1;
constexpr int64_t PULSE_TICKS = 3;

double larger(double a, double b) { return b > a ? b : a; }

// dead_zone.clear_of: the least speed to send for a dead band; 0 for none.
double clear_of(double band, double step) { return band > 0.0 ? (1.0 + PULSE_MARGIN) * band + step : 0.0; }

// motion_errors.quantise: the nearest whole multiple of a step.
double quantise(double value, double step) { return step == 0.0 ? value : step * floor(value / step + 0.5); }

// motion_errors.apply_base_errors: what a base makes of a command.
Velocity apply_base_errors(const Trials &trials, int64_t trial, double v, double omega, Velocity before) {
    const double *motors = &trials.motors(trial, 0);
    const double dead_band_v = motors[0], dead_band_omega = motors[1], wheel_min = motors[2], slow_wheel = motors[3],
                 half_track = motors[4], kinetic = 1.0 - motors[5];
    if (fabs(v) < dead_band_v * (before.v == 0.0 ? 1.0 : kinetic)) v = 0.0;
    if (fabs(omega) < dead_band_omega * (before.omega == 0.0 ? 1.0 : kinetic)) omega = 0.0;
    if (wheel_min > 0.0) {
        double left = v - omega * half_track, right = v + omega * half_track;
        if (fabs(left) < wheel_min) left = left == 0.0 ? 0.0 : copysign(slow_wheel, left);
        if (fabs(right) < wheel_min) right = right == 0.0 ? 0.0 : copysign(slow_wheel, right);
        v = 0.5 * (left + right);
        omega = 0.5 * (right - left) / half_track;
    }
    const double forward = trials.gain(trial, 0) * v, turn = trials.gain(trial, 1) * omega;
    return {forward, turn * (1.0 - trials.slip(trial) * fabs(turn)) + trials.wheel_mismatch(trial) * forward};
}

// motion_errors.dead_reckon: where odometry believes to be after a tick, its heading not wrapped.
Pose dead_reckon(const Trials &trials, int64_t trial, Pose believed, Pose before, Pose after) {
    const double distance_scale = trials.odometry(trial, 0), rotation_center = trials.turning(trial, 1);
    double heading_scale = 1.0, wheel_mismatch = 0.0, slip = 0.0, turn_gain = 1.0;
    if (!trials.measures_turn) {
        heading_scale = trials.odometry(trial, 1);
        turn_gain = trials.turning(trial, 0);
        wheel_mismatch = trials.wheel_mismatch(trial);
        slip = trials.slip(trial);
    }
    const double dx = after.x - before.x, dy = after.y - before.y;
    double cosine = cos(before.theta), sine = sin(before.theta);
    double turn = after.theta - before.theta;
    if (turn > PI)
        turn -= TAU;
    else if (turn <= -PI)
        turn += TAU;
    const double ahead = distance_scale * (cosine * dx + sine * dy + 0.5 * rotation_center * turn * turn);
    const double left = distance_scale * (cosine * dy - sine * dx - rotation_center * turn) / turn_gain;
    turn /= turn_gain;
    turn = turn * (1.0 + slip * fabs(turn) / TICK_S) - wheel_mismatch * ahead;
    cosine = cos(believed.theta), sine = sin(believed.theta);
    return {believed.x + cosine * ahead - sine * left, believed.y + sine * ahead + cosine * left,
            believed.theta + (heading_scale * turn + trials.drift(trial) * TICK_S)};
}

// The lanes at work, and what they read and write.
struct Episodes {
    const Circuits &circuits;
    const Indices &signal_at;  // (inputs,) the signal of each input
    const Tasks &tasks;
    const Trials &trials;
    const Lanes &lanes;
    const Fleet &fleet;
    const Queue &queue;

    // Begin an episode: the trial's rover at its start, no start signal, every neuron at rest.
    void start(int64_t lane, int64_t episode) const {
        fill_lane(circuits, lane, &queue.vectors(queue.vector(episode), 0));
        for (int64_t neuron = 0; neuron < circuits.potentials.shape[0]; neuron++)
            circuits.potentials(neuron, lane) = RESTING_MV;
        const int64_t trial = queue.trial(episode);
        lanes.episode(lane) = episode;
        lanes.task(lane) = queue.task(episode);
        lanes.trial(lane) = trial;
        lanes.tick(lane) = WARMING_UP;
        lanes.total(lane) = 0.0;
        lanes.holds(lane) = false;
        for (int axis = 0; axis < 3; axis++)
            lanes.odometry(axis, lane) = lanes.earlier(axis, lane) = trials.start(trial, axis);
        for (int axis = 0; axis < 2; axis++) {
            lanes.held(axis, lane) = lanes.tracking(axis, lane) = 0.0;
            for (int part = 0; part < 3; part++) lanes.pulses(axis, part, lane) = 0.0;
            const double gain = axis == 1 ? trials.turning(trial, 0) : 1.0;
            fleet.rise(axis, lane) = (tasks.limits(2 * axis) * trials.acceleration(trial, axis)) * SUBSTEP_S * gain;
            fleet.fall(axis, lane) =
                (tasks.limits(2 * axis + 1) * trials.acceleration(trial, axis + 2)) * SUBSTEP_S * gain;
            fleet.turning(axis, lane) = trials.turning(trial, axis);
        }
        fleet.set_delay(lane, trials.delay(trial, 0), trials.delay(trial, 1));
        put_at_start(lane);
        observe(lane, 0, 0.0);
    }

    void put_at_start(int64_t lane) const {
        const double *start = &trials.start(lanes.trial(lane), 0);
        fleet.place(lane, start[0], start[1], start[2]);
        for (int axis = 0; axis < 3; axis++) lanes.poses(axis, lane) = lanes.tail(lane, 0, axis) = start[axis];
        lanes.latest(lane) = 0;
    }

    // Write a lane's observation at the start of a tick: the noisy pose of odometry and the other signals.
    void observe(int64_t lane, int64_t tick, double signal) const {
        const int64_t task = lanes.task(lane), trial = lanes.trial(lane);
        double seen[SIGNALS];
        for (int axis = 0; axis < 3; axis++) {
            seen[axis] = lanes.odometry(axis, lane);
            if (trials.exact) continue;
            const double old = trials.age(trial, tick) * (lanes.odometry(axis, lane) - lanes.earlier(axis, lane));
            seen[axis] += trials.noise(trial, tick, axis) - old;
        }
        if (!trials.exact) {
            seen[2] = wrapped(seen[2]);
            const double *goal = &tasks.goal(task, 0);
            lanes.near_goal(lane) = hypot(seen[0] - goal[0], seen[1] - goal[1]) <= tasks.near(task, 0) &&
                                    fabs(wrapped(seen[2] - goal[2])) <= tasks.near(task, 1);
        }
        seen[3] = signal;
        for (int i = 4; i < SIGNALS; i++) seen[i] = 0.0;
        if (tasks.has_reference) {
            const double *reference = &tasks.reference(task, tick, 0);
            const double dx = reference[0] - seen[0], dy = reference[1] - seen[1];
            const double cosine = cos(seen[2]), sine = sin(seen[2]);
            double turned = reference[2] - seen[2];
            if (turned > PI)
                turned -= TAU;
            else if (turned <= -PI)
                turned += TAU;
            seen[4] = cosine * dx + sine * dy;
            seen[5] = cosine * dy - sine * dx;
            seen[6] = turned;
            seen[7] = reference[3];
            seen[8] = reference[4];
        }
        for (int64_t i = 0; i < signal_at.shape[0]; i++) lanes.observations(i, lane) = seen[signal_at(i)];
    }

    // Bring the commands to the bases, but for those lost. A rover stands while its lane is idle or warms up.
    void pass_commands() const {
        for (int64_t lane = 0; lane < lanes.episode.shape[0]; lane++) {
            const int64_t tick = lanes.tick(lane), trial = lanes.trial(lane);
            if (lanes.episode(lane) == IDLE || tick == WARMING_UP) {
                lanes.driven(0, lane) = lanes.driven(1, lane) = 0.0;
                continue;
            }
            const Velocity least = {clear_of(trials.motors(trial, 0), SPEED_STEP.v),
                                    clear_of(trials.motors(trial, 1), SPEED_STEP.omega)};
            double v = lanes.commands(0, lane), omega = lanes.commands(1, lane);
            if (!trials.exact && tick >= tasks.hold(lanes.task(lane)))
                lanes.holds(lane) = lanes.near_goal(lane) &&
                                    (lanes.holds(lane) || (fabs(v) < larger(HOLD.v, least.v) &&
                                                           fabs(omega) < larger(HOLD.omega, least.omega)));
            if (lanes.holds(lane)) v = omega = 0.0;
            v = send_pulse(0, lane, v, least.v);
            omega = send_pulse(1, lane, omega, least.omega);
            if (!trials.lost(trial, tick)) {
                lanes.held(0, lane) = quantise(v, trials.step(0));
                lanes.held(1, lane) = quantise(omega, trials.step(1));
            }
            const Velocity before = {lanes.driven(0, lane), lanes.driven(1, lane)};
            const Velocity motion = apply_base_errors(trials, trial, lanes.held(0, lane), lanes.held(1, lane), before);
            lanes.driven(0, lane) = motion.v;
            lanes.driven(1, lane) = motion.omega;
        }
    }

    // dead_zone.pulsed: the command of a driver that knows the base's dead band.
    double send_pulse(int axis, int64_t lane, double wanted, double least) const {
        if (least == 0.0) return wanted;
        double &sent = lanes.pulses(axis, 0, lane), &owed = lanes.pulses(axis, 1, lane),
               &ticks = lanes.pulses(axis, 2, lane);
        if (wanted == 0.0 || fabs(wanted) >= least) {
            owed = ticks = 0.0;
            return sent = wanted;
        }
        const double total = wanted + owed;
        const int64_t lasted = (int64_t)ticks;
        if (!(0 < lasted && lasted < PULSE_TICKS))
            sent = total * copysign(1.0, wanted) >= 0.5 * least ? copysign(least, wanted) : 0.0;
        owed = total - sent;
        ticks = sent != 0.0 ? (double)(lasted % PULSE_TICKS + 1) : 0.0;
        return sent;
    }

    // Judge what a tick led to, and observe.
    void finish_tick() const {
        for (int64_t lane = 0; lane < lanes.episode.shape[0]; lane++) {
            const int64_t episode = lanes.episode(lane), task = lanes.task(lane), now = lanes.tick(lane);
            if (episode == IDLE) continue;
            lanes.tick(lane) = now + 1;
            if (now == WARMING_UP) {
                // The rover stood still, but for what the last contact of its last episode left to correct.
                put_at_start(lane);
                observe(lane, 0, tasks.signal(task, 0));
                continue;
            }
            const double *pose[3] = {&lanes.poses(0, lane), &lanes.poses(1, lane), &lanes.poses(2, lane)};
            const int64_t target = tasks.due(task, now);
            if (target >= 0) {
                const double *checkpoint = &tasks.checkpoints(task, target, 0);
                const double dx = *pose[0] - checkpoint[0], dy = *pose[1] - checkpoint[1];
                const double dtheta = wrapped(*pose[2] - checkpoint[2]);
                lanes.total(lane) -= dx * dx + dy * dy + dtheta * dtheta;
                queue.residuals(episode, target, 0) = dx;
                queue.residuals(episode, target, 1) = dy;
                queue.residuals(episode, target, 2) = dtheta;
            }
            if (tasks.has_reference) {
                const double *reference = &tasks.reference(task, now + 1, 0);
                const double dx = *pose[0] - reference[0], dy = *pose[1] - reference[1];
                const double dtheta = wrapped(*pose[2] - reference[2]);
                lanes.tracking(0, lane) += dx * dx + dy * dy;
                lanes.tracking(1, lane) += dtheta * dtheta;
            }
            keep_pose(lane, now + 1);
            if (now + 1 == tasks.ticks(task) || lanes.total(lane) < queue.stop_below(episode)) {
                conclude(lane, &queue.results(episode, 0));
                lanes.episode(lane) = IDLE;
            } else {
                observe(lane, now + 1, tasks.signal(task, now + 1));
            }
        }
    }

    // Move odometry by a tick, push the rover if that is due, and keep its pose.
    void keep_pose(int64_t lane, int64_t ticks_done) const {
        const int64_t trial = lanes.trial(lane);
        const Matrix &poses = lanes.poses, &odometry = lanes.odometry;
        const bool measures_pose = trials.exact || trials.measures_pose;
        if (!trials.exact)
            for (int axis = 0; axis < 3; axis++) lanes.earlier(axis, lane) = odometry(axis, lane);
        if (!measures_pose) {
            const double *before = &lanes.tail(lane, lanes.latest(lane), 0);
            const Pose pose = dead_reckon(trials, trial, {odometry(0, lane), odometry(1, lane), odometry(2, lane)},
                                          {before[0], before[1], before[2]},
                                          {poses(0, lane), poses(1, lane), poses(2, lane)});
            odometry(0, lane) = pose.x;
            odometry(1, lane) = pose.y;
            odometry(2, lane) = pose.theta;
        }
        const double *bump = &trials.bump(trial, 0);
        if (!trials.exact && ticks_done == (int64_t)floor(bump[0] * (double)tasks.ticks(lanes.task(lane)))) {
            fleet.push(lane, bump[1], bump[2], bump[3]);
            fleet.read_pose(poses, lane);
        }
        const int64_t row = (lanes.latest(lane) + 1) % lanes.tail.shape[1];
        lanes.latest(lane) = row;
        for (int axis = 0; axis < 3; axis++) {
            if (measures_pose) odometry(axis, lane) = poses(axis, lane);
            lanes.tail(lane, row, axis) = poses(axis, lane);
        }
    }

    // Write how an episode ended (RESULTS of sim/learn). Of one that is truncated only the return counts.
    void conclude(int64_t lane, double *results) const {
        const int64_t task = lanes.task(lane), ticks = lanes.tick(lane), length = lanes.tail.shape[1];
        const int64_t latest = lanes.latest(lane), still = tasks.still(task);
        const double *end = &lanes.tail(lane, latest, 0), *goal = &tasks.goal(task, 0);
        double moved = 0.0, turned = 0.0;
        for (int64_t back = 0; back <= (still < ticks ? still : ticks); back++) {
            const double *pose = &lanes.tail(lane, (latest - back + length) % length, 0);
            moved = larger(moved, hypot(pose[0] - end[0], pose[1] - end[1]));
            turned = larger(turned, fabs(wrapped(pose[2] - end[2])));
        }
        results[0] = lanes.total(lane);
        results[1] = hypot(end[0] - goal[0], end[1] - goal[1]);
        results[2] = fabs(wrapped(end[2] - goal[2]));
        results[3] = moved;
        results[4] = turned;
        results[5] = (double)fleet.touched(lane);
        results[6] = lanes.tracking(0, lane) / (double)ticks;
        results[7] = lanes.tracking(1, lane) / (double)ticks;
    }

    // The waiting episode that a free lane takes, or NONE. It is one of the group that is behind the others: otherwise
    // groups of short episodes would end early, and leave lanes idle while the others go on.
    int64_t take_episode() const {
        const auto &[submitted, begun, left, begun_in_all] = queue.waiting;
        int64_t behind = NONE;
        for (int64_t group = 0; group < left.shape[0]; group++)
            if (begun(group) < submitted(group) && (behind == NONE || begun_in_all(group) < begun_in_all(behind)))
                behind = group;
        if (behind == NONE) return NONE;
        begun_in_all(behind)++;
        return behind * queue.group_size() + begun(behind)++;
    }

    // Run until a group has ended, until no episode is left, or for so many ticks. Return whether there is nothing more
    // to do before the next call.
    bool run(int64_t max_ticks) const {
        const int64_t count = lanes.episode.shape[0];
        int64_t running = 0;
        bool ended = false;
        for (int64_t lane = 0; lane < count; lane++) running += lanes.episode(lane) != IDLE;
        for (int64_t ticks = 0; ticks < max_ticks && !ended; ticks++) {
            for (int64_t lane = 0; lane < count && running < count; lane++) {
                if (lanes.episode(lane) != IDLE) continue;
                const int64_t episode = take_episode();
                if (episode == NONE) break;
                start(lane, episode);
                running++;
            }
            if (running == 0) return true;
            for (int64_t lane = 0; lane < count; lane++) lanes.before(lane) = lanes.episode(lane);
            tick_lanes(circuits, lanes.observations, lanes.commands);
            pass_commands();
            fleet.send(lanes.driven);
            fleet.advance();
            for (int64_t lane = 0; lane < count; lane++) fleet.read_pose(lanes.poses, lane);
            finish_tick();
            for (int64_t lane = 0; lane < count; lane++) {
                if (lanes.episode(lane) == lanes.before(lane)) continue;
                running--;
                if (--queue.waiting.left(lanes.before(lane) / queue.group_size()) == 0) ended = true;
            }
        }
        return ended;
    }
};

}  // namespace

extern "C" {
#pragma GCC visibility push(default)

int64_t rover_ncp_signals() { return SIGNALS; }

// The bytes of the structures that rover_ncp_run_episodes takes: core.py compares its own with them.
void rover_ncp_sizes(int64_t *sizes) {
    const int64_t found[] = {sizeof(Circuits), sizeof(Indices), sizeof(Tasks), sizeof(Trials),
                             sizeof(Lanes),    sizeof(Fleet),   sizeof(Queue)};
    for (int i = 0; i < 7; i++) sizes[i] = found[i];
}

// Let the first `count` episodes of a group, none of which waits or runs, wait with new vectors and thresholds. Return
// 0, or 1 if a parameter is not finite: then none waits.
int64_t rover_ncp_submit(const Queue *queue, int64_t group, int64_t count, const double *vectors,
                         const double *stop_below) {
    const auto &[submitted, begun, left, begun_in_all] = queue->waiting;
    const int64_t first = group * queue->group_size(), parameters = queue->vectors.shape[1];
    const int64_t numbers = queue->residuals.shape[1] * queue->residuals.shape[2];
    for (int64_t i = 0; i < count * parameters; i++)
        if (!(vectors[i] - vectors[i] == 0.0)) return 1;
    for (int64_t i = 0; i < count; i++) {
        const int64_t episode = first + i;
        double *vector = &queue->vectors(queue->vector(episode), 0), *residuals = &queue->residuals(episode, 0, 0);
        for (int64_t p = 0; p < parameters; p++) vector[p] = vectors[i * parameters + p];
        for (int64_t r = 0; r < numbers; r++) residuals[r] = 0.0;
        queue->stop_below(episode) = stop_below[i];
    }
    begun(group) = 0;
    submitted(group) = left(group) = count;
    return 0;
}

int64_t rover_ncp_run_episodes(const Circuits *circuits, const Indices *signal_at, const Tasks *tasks,
                               const Trials *trials, const Lanes *lanes, const Fleet *fleet, const Queue *queue,
                               int64_t max_ticks) {
    return Episodes{*circuits, *signal_at, *tasks, *trials, *lanes, *fleet, *queue}.run(max_ticks);
}
#pragma GCC visibility pop
}
