#include "fleet.h"

namespace {

constexpr int PARTS = WIDTH / REGISTER;
using V = Vec<PARTS>;

// rover.toward in each lane: speed moved toward target by at most rise, or fall while its size shrinks.
INLINE V toward(V speed, V target, V rise, V fall) {
    const V step = where_less(speed * (target - speed), V(0.0), fall, rise);
    return smaller(larger(target, speed - step), speed + step);
}

void set_touched(void *, void *, void *touched) { *(int64_t *)touched = 1; }

}  // namespace

void Fleet::send(const Matrix &commands) const {
    const int64_t rows = due.shape[0], now = clock(0), lanes = bodies.shape[0];
    const Matrix fallen_due = {due.data + now * 2 * lanes, {2, lanes}};
    const int64_t next = clock(0) = (now + 1) % rows;
    for (int axis = 0; axis < 2; axis++) {
        for (int64_t start = 0; start < lanes; start += WIDTH) {
            store_lanes(old, axis, start, load_lanes<PARTS>(fallen_due, axis, start));
            const V limit = load_lanes<PARTS>(top, axis, start);
            V command = smaller(larger(load_lanes<PARTS>(commands, axis, start), -1.0 * limit), limit);
            if (axis == 1) command = load_lanes<PARTS>(turning, 0, start) * command;
            store_lanes(target, axis, start, command);
        }
        // The longest delay ends in the row of the tick before, whose targets are in `old` by now.
        for (int64_t lane = 0; lane < lanes; lane++) due((next + waits(axis, lane)) % rows, axis, lane) = target(axis, lane);
    }
}

void Fleet::advance() const {
    const int64_t lanes = bodies.shape[0];
    const Matrix current = {due.data + clock(0) * 2 * lanes, {2, lanes}};
    const bool open_ground = shapes.shape[0] == 0;
    for (int64_t start = 0; start < lanes; start += WIDTH) {
        const int64_t count = lanes - start < WIDTH ? lanes - start : WIDTH;
        for (int substep = 0; substep < SUBSTEPS; substep++) {
            const V now((double)substep);
            double cosines[WIDTH], sines[WIDTH];
            for (int64_t i = 0; i < WIDTH; i++) {
                const int64_t lane = start + (i < count ? i : count - 1);
                const Point rotation = chipmunk.rotation(bodies(lane));
                cosines[i] = rotation.x;
                sines[i] = rotation.y;
                if (open_ground) continue;
                const Point moving = chipmunk.velocity(bodies(lane));
                velocity(0, lane) = moving.x;
                velocity(1, lane) = moving.y;
                velocity(2, lane) = chipmunk.angular_velocity(bodies(lane));
            }
            const V cosine = load<PARTS>(cosines), sine = load<PARTS>(sines);
            const V vx = load_lanes<PARTS>(velocity, 0, start), vy = load_lanes<PARTS>(velocity, 1, start);
            V omega = load_lanes<PARTS>(velocity, 2, start);
            // rover.own_axes
            const V along = cosine * vx + sine * vy;
            V sideways = cosine * vy - sine * vx;
            const V turn = omega * SUBSTEP_S;
            const V square = turn * turn;
            V forward = along * (1.0 - 0.5 * square) - sideways * (turn * (1.0 - square / 6.0));
            V wanted = where_less(now, load_lanes<PARTS>(late, 0, start), load_lanes<PARTS>(old, 0, start),
                                  load_lanes<PARTS>(current, 0, start));
            forward = toward(forward, wanted, load_lanes<PARTS>(rise, 0, start), load_lanes<PARTS>(fall, 0, start));
            wanted = where_less(now, load_lanes<PARTS>(late, 1, start), load_lanes<PARTS>(old, 1, start),
                                load_lanes<PARTS>(current, 1, start));
            omega = toward(omega, wanted, load_lanes<PARTS>(rise, 1, start), load_lanes<PARTS>(fall, 1, start));
            const V friction = load_lanes<PARTS>(grip, 0, start);
            sideways = toward(sideways, load_lanes<PARTS>(turning, 1, start) * omega, friction, friction);
            // Adding 0 makes 0 of -0, as Chipmunk's step does.
            double xs[WIDTH], ys[WIDTH], turns[WIDTH];
            store(xs, cosine * forward - sine * sideways + 0.0);
            store(ys, sine * forward + cosine * sideways + 0.0);
            store(turns, omega + 0.0);
            for (int64_t i = 0; i < count; i++) {
                const int64_t lane = start + i;
                double &x = velocity(0, lane), &y = velocity(1, lane), &turn_rate = velocity(2, lane);
                if (x != xs[i] || y != ys[i]) chipmunk.set_velocity(bodies(lane), {x = xs[i], y = ys[i]});
                if (turn_rate != turns[i]) chipmunk.set_angular_velocity(bodies(lane), turn_rate = turns[i]);
                if (open_ground) chipmunk.update_position(bodies(lane), SUBSTEP_S);
            }
            if (open_ground) continue;
            for (int64_t lane = start; lane < start + count; lane += sharing) chipmunk.step(spaces(lane), SUBSTEP_S);
            for (int64_t lane = start; lane < start + count; lane++)
                chipmunk.each_arbiter(bodies(lane), set_touched, &touched(lane));
        }
    }
}

void Fleet::read_pose(const Matrix &poses, int64_t lane) const {
    const Point at = chipmunk.position(bodies(lane));
    poses(0, lane) = at.x;
    poses(1, lane) = at.y;
    poses(2, lane) = wrapped(chipmunk.angle(bodies(lane)));
}
