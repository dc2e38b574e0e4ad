// The smoothness loss on the device: adds the gradient of embeddings to Adam's moments.
//   embed_smoothness_add   grad [n][len] of rows from .. from + n - 1 -> both moments of the
//                          embeddings (render/adam.cl, compiled before); from is the first row of a
//                          group
// The next Adam step multiplies the moments by beta1 and beta2 and adds its own gradient. Therefore
//   m1 += (1 - beta1) / beta1 g,   m2 += (1 - beta2) / beta2 g^2
// adds g to the first moment, and g^2 to the second. The second lacks 2 g g', with g' the gradient
// of the frame. That is 0 if the Gaussian was not visible. `salt` tells this rounding from those of
// steps.

// Column k of the rows of this work-item; 0 for rows that are not there.
INLINE V embed_smoothness_column(__global const float *grad, uint i, uint n, uint k, uint len)
{
#if VW == 16
    float g[LAYOUT_LANES];
    for (uint lane = 0; lane < LAYOUT_LANES; lane++)
        g[lane] = i + lane < n ? grad[(size_t)(i + lane) * len + k] : 0.0f;
    return LAYOUT_WIDE(__private, float, g);
#else
    return grad[(size_t)i * len + k];
#endif
}

__kernel void embed_smoothness_add(__global const float *grad, uint from, uint n, uint planes,
                                   uint first, uint len, float k1, float k2, uint salt,
                                   __global uint *moments)
{
    uint i = (uint)get_global_id(0) * VW, row = from + i;
    if (i >= n)
        return;
    __global uint *at = moments + group_at(row / LAYOUT_LANES, planes) + row % LAYOUT_LANES;
    VU key = adam_key(row, salt);
    for (uint k = 0; k < len; k++) {
        V g = embed_smoothness_column(grad, i, n, k, len);
        VU was = LD_WORD(at, first + k);
        ST_WORD(
            at, first + k,
            adam_word(key, first + k, adam_first(was) + k1 * g, adam_second(was) + k2 * (g * g)));
    }
}
