// Arrays as Python hands them over, and vectors of eight lanes.
//
// C++17 without its library: a compiler without headers of C++ builds it, and the shared library needs only libm.

#ifndef ROVER_NCP_ARRAYS_H
#define ROVER_NCP_ARRAYS_H

#include <stdint.h>

// A C-contiguous numpy array of N axes. core.py writes the address and the shape.
template <typename T, int N>
struct Array {
    T *data;
    int64_t shape[N];

    T &operator()(int64_t i) const { return data[i]; }
    T &operator()(int64_t i, int64_t j) const { return data[i * shape[1] + j]; }
    T &operator()(int64_t i, int64_t j, int64_t k) const { return data[(i * shape[1] + j) * shape[2] + k]; }
    int64_t size() const {
        int64_t product = 1;
        for (int axis = 0; axis < N; axis++) product *= shape[axis];
        return product;
    }
};

using Doubles = Array<double, 1>;
using Matrix = Array<double, 2>;
using Cube = Array<double, 3>;
using Indices = Array<int64_t, 1>;
using IndexMatrix = Array<int64_t, 2>;

// Lanes that are stored side by side, and worked on together.
constexpr int64_t WIDTH = 8;

#if defined(__AVX__)
constexpr int REGISTER = 4;  // doubles in a register
#else
constexpr int REGISTER = 2;
#endif
// Vectors must not be passed through memory.
#define INLINE inline __attribute__((always_inline))

typedef double Register __attribute__((vector_size(REGISTER * 8)));
typedef double InMemory __attribute__((vector_size(REGISTER * 8), aligned(8)));
typedef int64_t IntRegister __attribute__((vector_size(REGISTER * 8)));

// The same number of all lanes, in PARTS registers. Compilers keep an array of registers in registers, but move a
// single vector of 64 bytes through memory.
template <int PARTS>
struct Vec {
    Register part[PARTS];

    Vec() = default;
    INLINE Vec(double number) {
        _Pragma("GCC unroll 8") for (int i = 0; i < PARTS; i++) part[i] = number - Register{};
    }
};

#define EACH_PART _Pragma("GCC unroll 8") for (int i = 0; i < PARTS; i++)
#define OPERATOR(symbol)                                       \
    template <int PARTS>                                       \
    INLINE Vec<PARTS> operator symbol(Vec<PARTS> a, Vec<PARTS> b) { \
        EACH_PART a.part[i] = a.part[i] symbol b.part[i];      \
        return a;                                              \
    }                                                          \
    template <int PARTS>                                       \
    INLINE Vec<PARTS> operator symbol(double a, Vec<PARTS> b) { \
        return Vec<PARTS>(a) symbol b;                         \
    }                                                          \
    template <int PARTS>                                       \
    INLINE Vec<PARTS> operator symbol(Vec<PARTS> a, double b) { \
        return a symbol Vec<PARTS>(b);                         \
    }
OPERATOR(+)
OPERATOR(-)
OPERATOR(*)
OPERATOR(/)
#undef OPERATOR

// Python's max(a, b) in each lane: a unless b is greater. So max(a, NaN) is a.
template <int PARTS>
INLINE Vec<PARTS> larger(Vec<PARTS> a, Vec<PARTS> b) {
    EACH_PART a.part[i] = b.part[i] > a.part[i] ? b.part[i] : a.part[i];
    return a;
}

// Python's min(a, b) in each lane: a unless b is less.
template <int PARTS>
INLINE Vec<PARTS> smaller(Vec<PARTS> a, Vec<PARTS> b) {
    EACH_PART a.part[i] = b.part[i] < a.part[i] ? b.part[i] : a.part[i];
    return a;
}

// In each lane: yes where a < b, else no.
template <int PARTS>
INLINE Vec<PARTS> where_less(Vec<PARTS> a, Vec<PARTS> b, Vec<PARTS> yes, Vec<PARTS> no) {
    EACH_PART yes.part[i] = a.part[i] < b.part[i] ? yes.part[i] : no.part[i];
    return yes;
}

// value * 2**n, n being the integer in the lowest bits of shifted; the result must be a normal number.
template <int PARTS>
INLINE Vec<PARTS> scale_by_power_of_two(Vec<PARTS> value, Vec<PARTS> shifted) {
    constexpr int EXPONENT_BIT = 52;
    EACH_PART value.part[i] = (Register)((IntRegister)value.part[i] + ((IntRegister)shifted.part[i] << EXPONENT_BIT));
    return value;
}

// Load lanes of a row whose WIDTH lanes are side by side.
template <int PARTS>
INLINE Vec<PARTS> load(const double *row) {
    Vec<PARTS> value;
    EACH_PART value.part[i] = *(const InMemory *)(row + i * REGISTER);
    return value;
}

// By assignment, not by memcpy: the compiler then knows that only doubles change, and loads no address again.
template <int PARTS>
INLINE void store(double *row, Vec<PARTS> value) {
    EACH_PART *(InMemory *)(row + i * REGISTER) = value.part[i];
}

// Load the lanes from start on of a row with all L lanes; lanes beyond the last repeat it.
template <int PARTS>
INLINE Vec<PARTS> load_lanes(const Matrix &rows, int64_t row, int64_t start) {
    const double *first = rows.data + row * rows.shape[1] + start;
    const int64_t left = rows.shape[1] - start;
    if (left >= PARTS * REGISTER) return load<PARTS>(first);
    double copy[PARTS * REGISTER];
    for (int64_t i = 0; i < PARTS * REGISTER; i++) copy[i] = first[i < left ? i : left - 1];
    return load<PARTS>(copy);
}

// Store the lanes from start on of a row with all L lanes; lanes beyond the last are dropped.
template <int PARTS>
INLINE void store_lanes(const Matrix &rows, int64_t row, int64_t start, Vec<PARTS> value) {
    double *first = rows.data + row * rows.shape[1] + start;
    const int64_t left = rows.shape[1] - start;
    if (left >= PARTS * REGISTER) return store(first, value);
    double copy[PARTS * REGISTER];
    store(copy, value);
    for (int64_t i = 0; i < left; i++) first[i] = copy[i];
}
#undef EACH_PART

#endif
