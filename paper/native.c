/* Episodes of the benchmarks in lanes, and the networks. episodes.py compiles this file and calls it.

A lane has an episode of its own; the others wait in a queue for a free lane. Arithmetic is strict IEEE: the compiler
must not fuse operations (-ffp-contract=off). An episode then has the same bits in any lane and beside any others. */

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

enum { LANES = 8 }; /* the width of a vector; episodes.py has it too */
enum { MOUNTAIN_CAR, CART_POLE, WRITTEN_PENDULUM, PENDULUM, HALF_CHEETAH };
static const double TILTED_RAD = 0.2; /* ends an episode: gymnasium/envs/mujoco/inverted_pendulum_v5.py */

typedef void (*MujocoFunction)(const void *model, void *data);

typedef struct { /* the addresses of MuJoCo's functions and model, and of each lane's data and arrays */
    MujocoFunction step, reset, forward;
    void *model, *data[LANES];
    double *qpos[LANES], *qvel[LANES], *ctrl[LANES];
} Mujoco;

typedef struct {
    int64_t kind, states, inputs, outputs, frames;
    double step_s; /* a step of the environment has this many frames, physics steps of this length */
    double bonus;  /* a pendulum's reward is higher by bonus * (1 - |x|) */
    int64_t horizon, warm_up; /* warm-up: ticks on the first observation, whose commands are ignored */
    int64_t count, waiting, running; /* episodes in all, the next one that has no lane yet, those in lanes */
    double *starts, *results; /* (count, states); (count, 3): Gymnasium's return, the sum of bonuses, steps */
    double *observations, *commands; /* (inputs, LANES), (outputs, LANES) */
    double *state; /* (LANES, states), positions before velocities */
    int64_t episode[LANES], tick[LANES]; /* episode -1: the lane is free */
    bool fresh[LANES]; /* whether the plant has not moved yet */
    Mujoco mujoco;
} Episodes;

typedef struct { /* a C-contiguous array */
    double *data;
    int64_t rows, columns;
} Rows;

typedef struct { /* networks with a perceptron's one sum or an LSTM's four for each cell */
    int64_t gates, cells;
    double *weight; /* (size, LANES): of each sum the weights of inputs, of an LSTM's cells, bias; then outputs */
    double *hidden, *memory, *sums; /* (cells, LANES) twice, (gates * cells, LANES) */
} Networks;

/* Gymnasium's MountainCarContinuous-v0. Its state is float32, except before the first step of an episode; numpy adds
a plain number to a float32 in float32, and compares so. */
static double step_mountain_car(double *state, bool fresh, double action, bool *ended) {
    const double position = state[0];
    const double tripled = fresh ? 3.0 * position : (double)(3.0f * (float)position);
    double speed = state[1] + (action * 0.0015 - 0.0025 * cos(tripled));
    double goal = 0.45, place = position + speed;
    if (!(fabs(speed) <= 0.07)) {
        speed = copysign(0.07, speed);
        place = position + speed;
        if (!fresh) {
            place = (double)((float)position + (float)speed);
            goal = (double)0.45f;
        }
    }
    place = place < -1.2 ? -1.2 : place > 0.6 ? 0.6 : place;
    if (place == -1.2 && speed < 0.0) speed = 0.0;
    *ended = place >= goal && speed >= 0.0;
    state[0] = (float)place;
    state[1] = (float)speed;
    return (*ended ? 100.0 : 0.0) - 0.1 * (action * action);
}

/* Gymnasium's CartPole-v1, with a force of up to 10 N in place of two. Ends when the pole falls or the cart leaves. */
static bool step_cart_pole(double *state, double action) {
    const double total_kg = 1.1, pole_kg = 0.1, half_m = 0.5, pole_kg_m = 0.05, step_s = 0.02;
    const double speed = state[1], rate = state[3], cosine = cos(state[2]), sine = sin(state[2]);
    const double pushed = (10.0 * action + pole_kg_m * (rate * rate) * sine) / total_kg;
    const double turned =
        (9.8 * sine - cosine * pushed) / (half_m * (4.0 / 3.0 - pole_kg * (cosine * cosine) / total_kg));
    const double moved = pushed - pole_kg_m * turned * cosine / total_kg;
    state[0] += step_s * speed;
    state[2] += step_s * rate;
    state[1] = speed + step_s * moved;
    state[3] = rate + step_s * turned;
    return fabs(state[0]) > 2.4 || fabs(state[2]) > 0.20943951023931953; /* 12 degrees */
}

/* Gymnasium's inverted pendulum written out, in less than a twentieth of MuJoCo's time: the budget of 500 million steps
a run needs it. The pole turns on a hinge (positive about y) on a cart on a slider (along x), from
inverted_pendulum.xml: capsules of 1000 kg/m3 that touch nothing, friction of 1 N s/m and 1 N m s/rad, steps by
Runge-Kutta of fourth order. At an end of the slider MuJoCo pushes the cart back; here the episode ends. */
static void accelerate(double angle, double speed, double rate, double force, double *linear, double *angular) {
    const double pole_kg = 5.018591641363306, total_kg = 15.490567153329286; /* total: with the cart */
    const double inertia = 0.6404242692436963;      /* of the pole about the hinge */
    const double middle_x = 0.0005, middle_z = 0.3; /* of the upright pole, from the hinge */
    const double sine = sin(angle), cosine = cos(angle);
    const double aside = pole_kg * (middle_x * cosine + middle_z * sine);
    const double above = pole_kg * (middle_z * cosine - middle_x * sine);
    const double push = force - speed + aside * (rate * rate), turn = 9.81 * aside - rate;
    const double determinant = total_kg * inertia - above * above;
    *linear = (inertia * push - above * turn) / determinant;
    *angular = (total_kg * turn - above * push) / determinant;
}

static bool step_pendulum(double *state, double h, int64_t frames, double action) {
    double x = state[0], angle = state[1], v = state[2], w = state[3], force = 100.0 * action, half = 0.5 * h;
    bool beyond = false;
    for (int64_t frame = 0; frame < frames; frame++) {
        double a1, b1, a2, b2, a3, b3, a4, b4;
        accelerate(angle, v, w, force, &a1, &b1);
        const double v2 = v + half * a1, w2 = w + half * b1;
        accelerate(angle + half * w, v2, w2, force, &a2, &b2);
        const double v3 = v + half * a2, w3 = w + half * b2;
        accelerate(angle + half * w2, v3, w3, force, &a3, &b3);
        const double v4 = v + h * a3, w4 = w + h * b3;
        accelerate(angle + h * w3, v4, w4, force, &a4, &b4);
        const double furthest = fmax(fmax(fabs(x + half * v), fabs(x + half * v2)), fabs(x + h * v3));
        x += h / 6.0 * (v + 2.0 * (v2 + v3) + v4);
        angle += h / 6.0 * (w + 2.0 * (w2 + w3) + w4);
        v += h / 6.0 * (a1 + 2.0 * (a2 + a3) + a4);
        w += h / 6.0 * (b1 + 2.0 * (b2 + b3) + b4);
        beyond = beyond || !(furthest <= 1.0 && fabs(x) <= 1.0);
    }
    state[0] = x, state[1] = angle, state[2] = v, state[3] = w;
    return beyond || !(fabs(angle) <= TILTED_RAD);
}

static void step_mujoco(Episodes *e, int lane) {
    const Mujoco *m = &e->mujoco;
    const int64_t half = e->states / 2;
    double *state = e->state + lane * e->states;
    for (int64_t i = 0; i < e->outputs; i++) m->ctrl[lane][i] = e->commands[i * LANES + lane];
    for (int64_t frame = 0; frame < e->frames; frame++) m->step(m->model, m->data[lane]);
    memcpy(state, m->qpos[lane], half * sizeof(double));
    memcpy(state + half, m->qvel[lane], half * sizeof(double));
}

/* Advance one plant by the commands of its lane; add reward and bonus. Returns whether its episode has ended. */
static bool step_plant(Episodes *e, int lane, double *result) {
    double *state = e->state + lane * e->states, reward = 1.0, bonus = 0.0;
    const double action = e->commands[lane], before = state[0];
    bool ended = false;
    if (e->kind == MOUNTAIN_CAR) {
        reward = step_mountain_car(state, e->fresh[lane], action, &ended);
    } else if (e->kind == CART_POLE) {
        ended = step_cart_pole(state, action);
    } else if (e->kind == HALF_CHEETAH) {
        double squares = 0.0;
        for (int64_t i = lane; i < e->outputs * LANES; i += LANES) squares += e->commands[i] * e->commands[i];
        step_mujoco(e, lane);
        reward = (state[0] - before) / (e->step_s * e->frames) - 0.1 * squares; /* half_cheetah_v5.py */
    } else {
        if (e->kind == WRITTEN_PENDULUM) {
            ended = step_pendulum(state, e->step_s, e->frames, action);
        } else {
            step_mujoco(e, lane);
            ended = !(fabs(state[1]) <= TILTED_RAD) || !isfinite(state[0]);
        }
        reward = ended ? 0.0 : 1.0;
        bonus = ended ? 0.0 : e->bonus * (1.0 - fabs(state[0]));
    }
    e->fresh[lane] = false;
    result[0] += reward;
    result[1] += bonus;
    result[2] = e->tick[lane];
    return ended;
}

static void start_plant(Episodes *e, int lane, const double *start) {
    memcpy(e->state + lane * e->states, start, e->states * sizeof(double));
    e->fresh[lane] = true;
    if (e->kind == PENDULUM || e->kind == HALF_CHEETAH) {
        const Mujoco *m = &e->mujoco;
        const int64_t half = e->states / 2;
        m->reset(m->model, m->data[lane]);
        memcpy(m->qpos[lane], start, half * sizeof(double));
        memcpy(m->qvel[lane], start + half, half * sizeof(double));
        m->forward(m->model, m->data[lane]);
    }
}

/* Write a controller's observation, in the order of the task's inputs. */
static void observe(Episodes *e, int lane) {
    const double *state = e->state + lane * e->states;
    double *seen = e->observations + lane;
    if (e->kind == HALF_CHEETAH) {
        for (int64_t i = 1; i < e->states; i++) seen[(i - 1) * LANES] = state[i];
    } else if (e->kind == MOUNTAIN_CAR || e->kind == CART_POLE) { /* position and speed; the pole's angle and rate */
        const int64_t first = e->kind == MOUNTAIN_CAR ? 0 : 2;
        for (int64_t i = 0; i < 2; i++) seen[i * LANES] = (float)state[first + i];
    } else { /* the pole's angle, the cart's position */
        seen[0] = state[1];
        seen[LANES] = state[0];
    }
}

/* Take the commands of all lanes that have an episode, begin waiting episodes in free lanes, and observe. Writes how
many began, then lane and episode of each; -1 when all have ended. */
void step_episodes(Episodes *e, int64_t *started) {
    started[0] = 0;
    for (int lane = 0; lane < LANES; lane++) {
        const int64_t episode = e->episode[lane];
        if (episode >= 0 && ++e->tick[lane] > 0 &&
            (step_plant(e, lane, e->results + 3 * episode) || e->tick[lane] == e->horizon)) {
            e->episode[lane] = -1;
            e->running--;
        }
        if (e->episode[lane] < 0 && e->waiting < e->count) {
            started[2 * started[0] + 1] = lane;
            started[2 * started[0] + 2] = e->waiting;
            started[0]++;
            start_plant(e, lane, e->starts + e->waiting * e->states);
            e->tick[lane] = -e->warm_up;
            e->episode[lane] = e->waiting++;
            e->running++;
        }
        if (e->episode[lane] >= 0) observe(e, lane);
    }
    if (!e->running) started[0] = -1;
}

/* The hyperbolic tangent, with the exponential of rover_ncp/circuit/solver.py: the same bits on every machine. */
static inline double tangent(double z) {
    const double shift = 1.5 * 4503599627370496.0; /* adding it rounds to an integer in the sum's lowest bits */
    z = 2.8853900817779268 * (z < -30.0 ? -30.0 : z > 30.0 ? 30.0 : z); /* beyond 30 it is 1 to the last bit */
    const double shifted = z + shift, f = z - (shifted - shift), f2 = f * f, f4 = f2 * f2;
    const double low = (1.0 + 0.6931471805599453 * f) + (0.24022650695910158 + 0.055504108664821625 * f) * f2;
    const double middle =
        (0.009618129107587256 + 0.001333355814640647 * f) + (0.00015403530463724353 + 1.5252733841556773e-05 * f) * f2;
    const double high = (1.3215432535912375e-06 + 1.0178057087733941e-07 * f) +
                        (7.074194297288521e-09 + 4.4558179083360645e-10 * f) * f2;
    double power = low + (middle + high * f4) * f4;
    uint64_t bits, exponent;
    memcpy(&bits, &power, sizeof bits);
    memcpy(&exponent, &shifted, sizeof exponent);
    bits += exponent << 52;
    memcpy(&power, &bits, sizeof power);
    return 1.0 - 2.0 / (1.0 + power);
}

/* One tick of all lanes. An LSTM: Hochreiter and Schmidhuber (1997) with forget gates (Gers et al., 2000). */
#ifdef __x86_64__
__attribute__((target_clones("avx2", "default")))
#endif
static void
tick_networks(const Networks *n, int64_t inputs, int64_t outputs, const double *observations, double *commands) {
    const int64_t recurrent = n->gates > 1 ? n->cells : 0, row = n->cells * LANES;
    const double *weight = n->weight;
    for (int64_t sum = 0; sum < n->gates * n->cells; sum++) {
        const double *bias = weight + (inputs + recurrent) * LANES;
        double total[LANES];
        memcpy(total, bias, sizeof total);
        for (int64_t i = 0; i < inputs; i++, weight += LANES)
            for (int lane = 0; lane < LANES; lane++) total[lane] += weight[lane] * observations[i * LANES + lane];
        for (int64_t i = 0; i < recurrent; i++, weight += LANES)
            for (int lane = 0; lane < LANES; lane++) total[lane] += weight[lane] * n->hidden[i * LANES + lane];
        memcpy(n->sums + sum * LANES, total, sizeof total);
        weight += LANES;
    }
    for (int64_t i = 0; i < row; i++) {
        const double *sums = n->sums + i;
        if (n->gates == 1) {
            n->hidden[i] = tangent(sums[0]);
        } else { /* a logistic gate is half a tangent of half its argument, plus a half */
            const double input = 0.5 + 0.5 * tangent(0.5 * sums[0]), forget = 0.5 + 0.5 * tangent(0.5 * sums[row]);
            const double output = 0.5 + 0.5 * tangent(0.5 * sums[3 * row]);
            n->memory[i] = forget * n->memory[i] + input * tangent(sums[2 * row]);
            n->hidden[i] = output * tangent(n->memory[i]);
        }
    }
    for (int64_t o = 0; o < outputs; o++, weight += LANES) {
        double z[LANES];
        memcpy(z, weight + row, sizeof z);
        for (int64_t i = 0; i < n->cells; i++, weight += LANES)
            for (int lane = 0; lane < LANES; lane++) z[lane] += weight[lane] * n->hidden[i * LANES + lane];
        for (int lane = 0; lane < LANES; lane++)
            commands[o * LANES + lane] = z[lane] < -1.0 ? -1.0 : z[lane] > 1.0 ? 1.0 : z[lane];
    }
}

/* Run all episodes with circuits: rover_ncp's native library has the functions, and reads the structures. */
void run_circuits(Episodes *e, void (*fill)(const void *circuits, const Rows *vectors, int64_t first_lane),
                  void (*tick)(const void *circuits, const void *observations, const void *commands),
                  const void *circuits, const void *observations, const void *commands, int64_t size, int64_t neurons,
                  double *vectors, double *potentials, double rest) { /* (episodes, size), (neurons, LANES) */
    int64_t started[1 + 2 * LANES];
    for (step_episodes(e, started); started[0] >= 0; step_episodes(e, started)) {
        for (int64_t s = 0; s < started[0]; s++) {
            const int64_t lane = started[1 + 2 * s], episode = started[2 + 2 * s];
            const Rows vector = {vectors + episode * size, 1, size};
            fill(circuits, &vector, lane);
            for (int64_t i = 0; i < neurons; i++) potentials[i * LANES + lane] = rest;
        }
        tick(circuits, observations, commands);
    }
}

/* Run all episodes with networks. */
void run_networks(Episodes *e, int64_t gates, int64_t cells, int64_t size, double *vectors, double *weight,
                  double *hidden, double *memory, double *sums) {
    const Networks n = {gates, cells, weight, hidden, memory, sums};
    int64_t started[1 + 2 * LANES];
    for (step_episodes(e, started); started[0] >= 0; step_episodes(e, started)) {
        for (int64_t s = 0; s < started[0]; s++) {
            const int64_t lane = started[1 + 2 * s], episode = started[2 + 2 * s];
            for (int64_t i = 0; i < size; i++) weight[i * LANES + lane] = vectors[episode * size + i];
            for (int64_t i = 0; i < cells; i++) hidden[i * LANES + lane] = memory[i * LANES + lane] = 0.0;
        }
        tick_networks(&n, e->inputs, e->outputs, e->observations, e->commands);
    }
}
