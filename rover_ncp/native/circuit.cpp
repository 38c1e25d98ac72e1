// The circuit's solver: many circuits of one wiring, one in each lane, advanced together.
//
// Hasani et al. (ICRA 2020), supplement eq. 1 to 6. For each neuron with capacitance C, leak conductance G and
// leak potential E_L, hybrid Euler steps of dt:
//
//     V <- (C / dt V + G E_L + sum_s g_s E_s + sum_j w_j V_j) / (C / dt + G + sum_s g_s + sum_j w_j)
//     g_s = w_s / (1 + exp(-sigma_s (V_s - mu)))
//
// s runs over chemical synapses (E_s is 0 mV if they excite, -90 mV if they inhibit), j over gap junctions. A step
// is implicit in the neuron's own potential V and explicit in those of its presynaptic neurons V_s and V_j.
//
// A lane has the same bits for any number of lanes: the order of operations is fixed, and the exponential is ours.
// circuit/reference.py is the readable definition, with the same bits. Sensory neurons are set, never integrated,
// and constant over a tick, so the currents of their synapses are summed up once a tick.

#include "circuit.h"

#ifdef __x86_64__
#include <cpuid.h>
#endif

namespace {

constexpr double MIDPOINT_MV = -40.0;    // mu
constexpr double INHIBITORY_MV = -90.0;  // the excitatory reversal potential is 0 and drops out
constexpr double LOG2_E = 1.4426950408889634;

// 2**z within 2 ulp for -1000 <= z <= 1000; outside, or for NaN, the result means nothing.
template <int PARTS>
INLINE Vec<PARTS> exp2(Vec<PARTS> z) {
    using V = Vec<PARTS>;
    // Adding it rounds a number below 2**51 to an integer, which then is in the lowest bits of the sum.
    constexpr double ROUNDER = 0x1.8p52;
    const V shifted = z + ROUNDER;
    const V f = z - (shifted - ROUNDER);
    // 2**f on [-1/2, 1/2], interpolated at Chebyshev nodes in 60 digits: relative error below 5e-18.
    // Estrin's scheme: short chains of dependent operations, so that a processor overlaps them.
    const V f2 = f * f;
    const V f4 = f2 * f2;
    const V low = (1.0 + 0.6931471805599453 * f) + (0.24022650695910158 + 0.055504108664821625 * f) * f2;
    const V middle = (0.009618129107587256 + 0.001333355814640647 * f) +
                     (0.00015403530463724353 + 1.5252733841556773e-05 * f) * f2;
    const V high = (1.3215432535912375e-06 + 1.0178057087733941e-07 * f) +
                   (7.074194297288521e-09 + 4.4558179083360645e-10 * f) * f2;
    return scale_by_power_of_two(low + (middle + high * f4) * f4, shifted);
}

// What a chemical synapse conducts: w / (1 + exp(-sigma (V - mu))). The slope is -sigma log2 e.
template <int PARTS>
INLINE Vec<PARTS> gate(Vec<PARTS> weight, Vec<PARTS> slope, Vec<PARTS> potential) {
    return weight / (1.0 + exp2(slope * (potential - MIDPOINT_MV)));
}

// PARTS registers of one block of WIDTH lanes.
template <int PARTS>
struct Block {
    using V = Vec<PARTS>;
    const Program &program;
    const LaneParameters &lanes;
    int64_t number;

    // A row of the arrays that have one block, and of those that have one for each block of lanes.
    static double *work(const Cube &cube, int64_t row) { return cube.data + row * WIDTH; }
    double *of_block(const Cube &cube, int64_t row) const {
        return cube.data + (number * cube.shape[1] + row) * WIDTH;
    }
    V potential(int64_t neuron) const { return load<PARTS>(work(lanes.potential, neuron)); }
    V parameter(const Cube &cube, int64_t row) const { return load<PARTS>(of_block(cube, row)); }

    void set_sensory_neurons(const Matrix &observations) const {
        const SensorMap &sensors = program.sensors;
        const int64_t columns = program.input_layer_at.shape[1];
        for (int64_t s = 0; s < sensors.neuron.shape[0]; s++) {
            const int64_t channel = sensors.channel(s);
            V value(0.0);
            if (columns == 0) value = load_lanes<PARTS>(observations, channel, number * WIDTH);
            for (int64_t i = 0; i < columns; i++)
                value = value + parameter(lanes.input_layer, channel * columns + i) *
                                    load_lanes<PARTS>(observations, i, number * WIDTH);
            // In this order a NaN, which only an overflow in the layer could make, reads as the lower end.
            const V potential = larger(V(sensors.lower(s)), sensors.base(s) + sensors.gain(s) * value);
            store(work(lanes.potential, sensors.neuron(s)), smaller(potential, V(sensors.upper(s))));
        }
    }

    // Sum up what is constant over a tick: leak and synapses of sensory neurons.
    void sum_input_synapses() const {
        const Synapses &synapses = program.input_synapses;
        const GapJunctions &gaps = program.input_gaps;
        for (int64_t d = 0; d < program.integrated.neuron.shape[0]; d++) {
            V current = parameter(lanes.leak_current, d), total = parameter(lanes.conductance, d);
            for (int64_t s = synapses.first(d); s < synapses.first(d + 1); s++) {
                const V g = gate(parameter(lanes.input_weight, s), parameter(lanes.input_slope, s),
                                 potential(synapses.source(s)));
                total = total + g;
                if (s >= synapses.first_inhibitory(d)) current = current + INHIBITORY_MV * g;
            }
            for (int64_t s = gaps.first(d); s < gaps.first(d + 1); s++)
                current = current + parameter(lanes.input_gap, s) * potential(gaps.source(s));
            store(work(lanes.current, d), current);
            store(work(lanes.total, d), total);
        }
    }

    // Advance the integrated neurons by a tick. In each substep first come all synapses, which need the old potentials
    // and not each other: the processor overlaps the division of one with the exponentials of the next.
    void run_substeps() const {
        const Synapses &synapses = program.recurrent_synapses;
        const GapJunctions &gaps = program.recurrent_gaps;
        const Indices &neurons = program.integrated.neuron;
        for (int64_t substep = 0; substep < program.substeps; substep++) {
            for (int64_t s = 0; s < synapses.source.shape[0]; s++)
                store(work(lanes.gate, s), gate(parameter(lanes.recurrent_weight, s),
                                                parameter(lanes.recurrent_slope, s), potential(synapses.source(s))));
            for (int64_t s = 0; s < gaps.source.shape[0]; s++)
                store(work(lanes.gap_current, s), parameter(lanes.recurrent_gap, s) * potential(gaps.source(s)));
            for (int64_t d = 0; d < neurons.shape[0]; d++) {
                V current = load<PARTS>(work(lanes.current, d)) + parameter(lanes.rate, d) * potential(neurons(d));
                V total = load<PARTS>(work(lanes.total, d));
                const int64_t inhibitory = synapses.first_inhibitory(d);
                for (int64_t s = synapses.first(d); s < inhibitory; s++)
                    total = total + load<PARTS>(work(lanes.gate, s));
                for (int64_t s = inhibitory; s < synapses.first(d + 1); s++) {
                    const V g = load<PARTS>(work(lanes.gate, s));
                    total = total + g;
                    current = current + INHIBITORY_MV * g;
                }
                for (int64_t s = gaps.first(d); s < gaps.first(d + 1); s++)
                    current = current + load<PARTS>(work(lanes.gap_current, s));
                store(work(lanes.potential, neurons(d)), current / total);
            }
        }
    }

    void read_motors(const Matrix &commands) const {
        const MotorMap &motors = program.motors;
        const IndexMatrix &layer = program.output_layer_at;
        for (int64_t channel = 0; channel < lanes.channel.shape[1]; channel++)
            store(work(lanes.channel, channel), V(0.0));
        for (int64_t q = 0; q < motors.neuron.shape[0]; q++) {
            const V fraction = (potential(motors.neuron(q)) - program.motor_low) * program.motor_scale;
            double *channel = work(lanes.channel, motors.channel(q));
            store(channel, load<PARTS>(channel) + motors.end(q) * smaller(larger(fraction, V(0.0)), V(1.0)));
        }
        for (int64_t o = 0; o < commands.shape[0]; o++) {
            V value(0.0);
            if (layer.shape[0] == 0) value = load<PARTS>(work(lanes.channel, o));
            for (int64_t i = 0; i < layer.shape[1]; i++)
                value = value + parameter(lanes.output_layer, o * layer.shape[1] + i) *
                                    load<PARTS>(work(lanes.channel, i));
            if (layer.shape[0] > 0 && program.output_limit.shape[0] > 0)
                value = program.output_limit(o) * smaller(larger(value, V(-1.0)), V(1.0));
            store_lanes(commands, o, number * WIDTH, value);
        }
    }

    void tick(const Matrix &potentials, const Matrix &observations, const Matrix &commands) const {
        for (int64_t neuron = 0; neuron < potentials.shape[0]; neuron++)
            store(work(lanes.potential, neuron), load_lanes<PARTS>(potentials, neuron, number * WIDTH));
        set_sensory_neurons(observations);
        sum_input_synapses();
        run_substeps();
        for (int64_t neuron = 0; neuron < potentials.shape[0]; neuron++)
            store_lanes(potentials, neuron, number * WIDTH, potential(neuron));
        read_motors(commands);
    }
};

void fill_synapses(const Synapses &synapses, const Cube &weight, const Cube &slope, int64_t lane,
                   const double *vector) {
    for (int64_t s = 0; s < synapses.source.shape[0]; s++) {
        weight(lane / WIDTH, s, lane % WIDTH) = vector[synapses.weight_at(s)];
        slope(lane / WIDTH, s, lane % WIDTH) = -LOG2_E * vector[synapses.sigma_at(s)];
    }
}

// The weights of gap junctions also add to the conductances of their destinations.
void fill_gaps(const GapJunctions &gaps, const Cube &weight, const Cube &conductance, int64_t lane,
               const double *vector) {
    for (int64_t d = 0; d + 1 < gaps.first.shape[0]; d++)
        for (int64_t s = gaps.first(d); s < gaps.first(d + 1); s++) {
            weight(lane / WIDTH, s, lane % WIDTH) = vector[gaps.weight_at(s)];
            conductance(lane / WIDTH, d, lane % WIDTH) += vector[gaps.weight_at(s)];
        }
}

}  // namespace

void fill_lane(const Circuits &circuits, int64_t lane, const double *vector) {
    const Program &program = circuits.program;
    const LaneParameters &lanes = circuits.parameters;
    const int64_t block = lane / WIDTH, place = lane % WIDTH;
    fill_synapses(program.input_synapses, lanes.input_weight, lanes.input_slope, lane, vector);
    fill_synapses(program.recurrent_synapses, lanes.recurrent_weight, lanes.recurrent_slope, lane, vector);
    const Integrated &neurons = program.integrated;
    for (int64_t d = 0; d < neurons.neuron.shape[0]; d++) {
        const double rate = vector[neurons.capacitance_at(d)] / program.dt_s;
        const double leak = vector[neurons.leak_at(d)];
        lanes.rate(block, d, place) = rate;
        lanes.leak_current(block, d, place) = leak * vector[neurons.leak_potential_at(d)];
        lanes.conductance(block, d, place) = rate + leak;
    }
    fill_gaps(program.input_gaps, lanes.input_gap, lanes.conductance, lane, vector);
    fill_gaps(program.recurrent_gaps, lanes.recurrent_gap, lanes.conductance, lane, vector);
    const int64_t inputs = program.input_range.shape[0];
    for (int64_t i = 0; i < program.input_layer_at.size(); i++)
        lanes.input_layer(block, i, place) = vector[program.input_layer_at.data[i]] / program.input_range(i % inputs);
    for (int64_t i = 0; i < program.output_layer_at.size(); i++)
        lanes.output_layer(block, i, place) = vector[program.output_layer_at.data[i]];
}

void tick_lanes(const Circuits &circuits, const Matrix &observations, const Matrix &commands) {
    const auto &[program, lanes, potentials] = circuits;
    const int64_t count = potentials.shape[1];
    if (count <= REGISTER) {  // one circuit that drives
        Block<1>{program, lanes, 0}.tick(potentials, observations, commands);
        return;
    }
    for (int64_t block = 0; block * WIDTH < count; block++)
        Block<WIDTH / REGISTER>{program, lanes, block}.tick(potentials, observations, commands);
}

extern "C" {
#pragma GCC visibility push(default)

// A digest of the sources of this build.
const char *rover_ncp_sources() { return SOURCES; }

// Whether processor and operating system run the build for AVX2, by Intel's manual, volume 1, 14.3 and 14.7:
// zig has no library for __builtin_cpu_supports.
int64_t rover_ncp_has_avx2() {
#ifdef __x86_64__
    constexpr unsigned OSXSAVE = 1 << 27, AVX2 = 1 << 5;
    constexpr unsigned AVX_KEPT = 0x6;  // registers that a change of process keeps
    unsigned eax, ebx, ecx, edx, kept, high;
    if (!__get_cpuid(1, &eax, &ebx, &ecx, &edx) || !(ecx & OSXSAVE)) return 0;
    __asm__("xgetbv" : "=a"(kept), "=d"(high) : "c"(0));
    return __get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx) && (ebx & AVX2) && (kept & AVX_KEPT) == AVX_KEPT;
#else
    return 0;
#endif
}

// Set as many lanes as there are parameter vectors (k, P), from the first on.
void rover_ncp_fill_lanes(const Circuits *circuits, const Matrix *vectors, int64_t first) {
    for (int64_t i = 0; i < vectors->shape[0]; i++) fill_lane(*circuits, first + i, &(*vectors)(i, 0));
}

void rover_ncp_tick_lanes(const Circuits *circuits, const Matrix *observations, const Matrix *commands) {
    tick_lanes(*circuits, *observations, *commands);
}
#pragma GCC visibility pop
}
