
/* 2^z for -1000 <= z <= 1000 (within 2 ulp). Adding the rounder leaves the nearest integer in the sum's lowest
   bits; a polynomial gives 2^f for the rest f in [-1/2, 1/2]. As float: the same to degree 7, z is cut to
   the type's exponents. */
static real power_of_two(real z)
{
#ifdef ROVER_NCP_FLOAT
    union { float value; uint32_t bits; } shifted, scaled;
    float f;
    z = larger(-126.0f, smaller(126.0f, z));
    shifted.value = z + ${float_rounder}f;
    f = z - (shifted.value - ${float_rounder}f);
    scaled.value = ${float_polynomial};
    scaled.bits += shifted.bits << 23;
#else
    union { double value; uint64_t bits; } shifted, scaled;
    double f, f2, f4, low, middle, high;
    shifted.value = z + $rounder;
    f = z - (shifted.value - $rounder);
    f2 = f * f;
    f4 = f2 * f2;
    low = ($c0 + $c1 * f) + ($c2 + $c3 * f) * f2;
    middle = ($c4 + $c5 * f) + ($c6 + $c7 * f) * f2;
    high = ($c8 + $c9 * f) + ($c10 + $c11 * f) * f2;
    scaled.value = low + (middle + high * f4) * f4;
    scaled.bits += shifted.bits << 52;
#endif
    return scaled.value;
}

/* Conductance in S of a chemical synapse; slope is -sigma log2(e). */
static real conductance(real weight, real slope, real potential)
{
    return weight / (R(1.0) + power_of_two(slope * (potential - R($midpoint_mV))));
}
