// Structures of the circuit's solver: the fields of the named tuples of circuit/compiled.py, in their order.

#ifndef ROVER_NCP_CIRCUIT_H
#define ROVER_NCP_CIRCUIT_H

#include "arrays.h"

struct SensorMap {
    Indices neuron, channel;
    Doubles base, gain, lower, upper;
};

struct Integrated {
    Indices neuron, leak_potential_at, leak_at, capacitance_at;
};

struct Synapses {
    Indices source, weight_at, sigma_at, first, first_inhibitory;
};

struct GapJunctions {
    Indices source, weight_at, first;
};

struct MotorMap {
    Indices neuron, channel;
    Doubles end;
};

struct Program {
    double dt_s;
    int64_t substeps;
    SensorMap sensors;
    Integrated integrated;
    Synapses input_synapses, recurrent_synapses;
    GapJunctions input_gaps, recurrent_gaps;
    MotorMap motors;
    double motor_low, motor_scale;
    IndexMatrix input_layer_at, output_layer_at;
    Doubles input_range, output_limit;
};

struct LaneParameters {
    Cube input_weight, input_slope, recurrent_weight, recurrent_slope, input_gap, recurrent_gap;
    Cube rate, leak_current, conductance, input_layer, output_layer;
    Cube potential, current, total, gate, gap_current, channel;
};

struct Circuits {
    Program program;
    LaneParameters parameters;
    Matrix potentials;
};

// Set the numbers of one lane from a parameter vector.
void fill_lane(const Circuits &circuits, int64_t lane, const double *vector);

// Advance all lanes by a control tick: observations (inputs, L) in, commands (outputs, L) out.
void tick_lanes(const Circuits &circuits, const Matrix &observations, const Matrix &commands);

#endif
