// Behind core/device/vector.cl in the programs that change Adam's two moments: how they are stored.
//
// Both are 16 bits, the upper half of a float (bfloat16): the range of a float, and a relative step
// of 2^-8 to 2^-7. They share a word, the first moment in its upper half.
//
// They are rounded at random, up as often as the discarded bits say, so that the mean over steps is
// right: a step without gradient takes a thousandth from the second moment, less than the distance
// of its neighbours, and rounding to the nearest would never let it fall. 0 stays 0, signs stay,
// and a number that 16 bits can hold stays as it is. The random bits follow from step, row and
// plane alone, so the result does not depend on who works when, and a run that is resumed goes on
// with the same bytes.

INLINE V adam_first(VU word)
{
    return AS_V(word & 0xffff0000u);
}

INLINE V adam_second(VU word)
{
    return AS_V(word << 16);
}

// Random bits of the rows from `row` on in a step: a hash of 32 bits, two rounds of xor-shift and
// multiply.
INLINE VU adam_key(uint row, uint step)
{
    VU x = AS_VU(LANE + (int)row) ^ (step * 0x9e3779b9u);
    x = (x ^ (x >> 16)) * 0x7feb352du;
    x = (x ^ (x >> 15)) * 0x846ca68bu;
    return x ^ (x >> 16);
}

// Both moments of a plane, each rounded by half of the bits. Planes of a row use the same bits from
// other places on, which costs one addition: each plane has even and independent bits over rows and
// steps, and no sum is over planes.
INLINE VU adam_word(VU key, uint plane, V first, V second)
{
    VU x = key + plane * 0x9e3779b9u;
    return ((AS_VU(first) + (x >> 16)) & 0xffff0000u) | ((AS_VU(second) + (x & 0xffffu)) >> 16);
}
