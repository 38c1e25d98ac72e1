// Many rovers stepped together, each to the last bit as sim/world/pymunk_rover.py would go.
//
// The rules of motion are those of sim/world/rover.py. Every substep of every rover is Chipmunk's own, reached through
// its public functions; an integrator of our own would be a second simulator. On open ground a step of the space does
// no more than to update the positions of its bodies: without gravity, damping and forces it keeps their velocities.
//
// Rovers that share a space do not collide with each other, and Chipmunk works relative to the space's origin. So a
// rover's path does not depend on the others.

#ifndef ROVER_NCP_FLEET_H
#define ROVER_NCP_FLEET_H

#include "arrays.h"

extern "C" double fmod(double, double);

constexpr double PI = 3.141592653589793, TAU = 6.283185307179586;
constexpr double SUBSTEP_S = 0.01;
constexpr int SUBSTEPS = 10;

// Chipmunk's cpVect.
struct Point {
    double x, y;
};

// Addresses of Chipmunk's public functions, from pymunk.
struct Chipmunk {
    void (*step)(void *space, double dt_s);
    void *(*add_shape)(void *space, void *shape);
    void (*remove_shape)(void *space, void *shape);
    Point (*position)(const void *body);
    void (*set_position)(void *body, Point position);
    double (*angle)(const void *body);
    void (*set_angle)(void *body, double angle);
    Point (*rotation)(const void *body);
    Point (*velocity)(const void *body);
    void (*set_velocity)(void *body, Point velocity);
    double (*angular_velocity)(const void *body);
    void (*set_angular_velocity)(void *body, double omega);
    void (*each_arbiter)(void *body, void (*call)(void *body, void *arbiter, void *data), void *data);
    void (*set_velocity_function)(void *body, void (*update)(void *body, Point gravity, double damping, double dt_s));
    void (*update_position)(void *body, double dt_s);
};

// Chipmunk's own function computes the same velocity again: there is neither gravity nor damping nor a force.
inline void keep_velocity(void *, Point, double, double) {}

// The fields of FleetArrays in sim/world/fleet.py; L rovers, as many lanes.
struct Fleet {
    Chipmunk chipmunk;
    Array<void *, 1> spaces;
    int64_t sharing;  // so many lanes after each other are in one space: a divisor of WIDTH
    Array<void *, 1> bodies, shapes;
    Matrix rise, fall, grip, top, turning;
    IndexMatrix waits;
    Matrix late;
    Cube due;
    Indices clock;
    Matrix old, target;
    Matrix velocity;  // (3, L) what Chipmunk has on open ground, where only we change it: x, y, rate of turn
    Indices touched;

    // Put a rover somewhere, standing still, its commands forgotten. Chipmunk keeps the part of a contact that it
    // applies in the next step: a rover that touched something must be placed a second time, after a step in the
    // open.
    void place(int64_t lane, double x, double y, double theta) const {
        void *body = bodies(lane), *space = spaces(lane);
        const bool has_shape = shapes.shape[0] > 0;
        // A shape taken out and put in again has left its contacts behind, and the hints that collision detection
        // keeps for its next search; with them the last bits of a path would depend on the rover's past.
        if (has_shape) chipmunk.remove_shape(space, shapes(lane));
        chipmunk.set_velocity_function(body, keep_velocity);
        chipmunk.set_position(body, {x, y});
        chipmunk.set_angle(body, theta);
        chipmunk.set_velocity(body, {0.0, 0.0});
        chipmunk.set_angular_velocity(body, 0.0);
        if (has_shape) chipmunk.add_shape(space, shapes(lane));
        for (int axis = 0; axis < 2; axis++) {
            old(axis, lane) = 0.0;
            for (int64_t row = 0; row < due.shape[0]; row++) due(row, axis, lane) = 0.0;
        }
        for (int axis = 0; axis < 3; axis++) velocity(axis, lane) = 0.0;
        touched(lane) = 0;
    }

    // Set after how many substeps commands fall due: at most those of the slowest model of the fleet.
    void set_delay(int64_t lane, int64_t delay_v, int64_t delay_omega) const {
        waits(0, lane) = delay_v / SUBSTEPS;
        late(0, lane) = (double)(delay_v % SUBSTEPS);
        waits(1, lane) = delay_omega / SUBSTEPS;
        late(1, lane) = (double)(delay_omega % SUBSTEPS);
    }

    // Command all rovers, (2, L): forward speed in m/s and rate of turn in rad/s; begins a tick.
    void send(const Matrix &commands) const;

    // Advance all rovers by the ten substeps of a tick.
    void advance() const;

    // Write a true pose into column lane of (3, L): x and y in m, heading in rad within (-pi, pi].
    void read_pose(const Matrix &poses, int64_t lane) const;

    // Shift a rover at once; it keeps its velocity.
    void push(int64_t lane, double x, double y, double theta) const {
        const Point at = chipmunk.position(bodies(lane));
        chipmunk.set_position(bodies(lane), {at.x + x, at.y + y});
        chipmunk.set_angle(bodies(lane), chipmunk.angle(bodies(lane)) + theta);
    }
};

// The same direction within (-pi, pi].
inline double wrapped(double angle) {
    if (-PI < angle && angle <= PI) return angle;
    angle = fmod(angle, TAU);
    if (angle > PI) return angle - TAU;
    if (angle <= -PI) return angle + TAU;
    return angle;
}

#endif
