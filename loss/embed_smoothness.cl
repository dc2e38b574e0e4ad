// The smoothness loss on the device: adds the gradient of embeddings to Adam's moments.
//   embed_smoothness_add   grad [n][len] of rows from .. from + n - 1 -> both moments of the
//                          embeddings
// The next Adam step multiplies the moments by beta1 and beta2 and adds its own gradient. Therefore
//   m1 += (1 - beta1) / beta1 g,   m2 += (1 - beta2) / beta2 g^2
// adds g to the first moment exactly, and g^2 to the second. The second lacks 2 g g', with g' the
// gradient of the frame. That is 0 if the Gaussian was not visible.

__kernel void embed_smoothness_add(__global const float *grad, uint from, uint n, uint planes,
                                   uint first, uint len, float k1, float k2, __global float *m1,
                                   __global float *m2)
{
    uint i = (uint)get_global_id(0), row = from + i;
    if (i >= n)
        return;
    size_t at = (size_t)(row / LAYOUT_LANES) * planes * LAYOUT_LANES + row % LAYOUT_LANES;
    for (uint k = 0; k < len; k++) {
        float g = grad[(size_t)i * len + k];
        size_t p = at + (first + k) * LAYOUT_LANES;
        m1[p] = m1[p] + k1 * g;
        m2[p] = m2[p] + k2 * (g * g);
    }
}
