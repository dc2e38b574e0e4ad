// The device's side of the smoothness loss: the gradient of embeddings into Adam.
//   embed_smoothness_add   grad [n][len] of rows from .. from + n - 1 -> both moments of the
//                          embeddings
// Adam's step that follows multiplies the moments by beta1 and beta2 and adds its own gradient, so
//   m1 += (1 - beta1) / beta1 g,   m2 += (1 - beta2) / beta2 g^2
// makes it a step with g added to the first moment exactly, and its square to the second. What is
// missing is 2 g g', g' the gradient of the frame: nothing where a Gaussian was not seen.

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
