// The device's side of the similarity loss: embeddings out of the model, their gradient into Adam.
//   similarity_pack  params -> rows [n][3 + len]: mean, embedding
//   similarity_add   grad [n][len] -> both moments of the embedding's planes
// Adam's step that follows multiplies the moments by beta1 and beta2 and adds its own gradient, so
//   m1 += (1 - beta1) / beta1 g,   m2 += (1 - beta2) / beta2 g^2
// makes it a step with g added to the first moment exactly, and its square to the second. What is
// missing is 2 g g', g' the gradient of the frame: nothing where a Gaussian was not seen.

__kernel void similarity_pack(__global const float *params, uint n, uint planes, uint first,
                              uint len, __global float *rows)
{
    uint i = (uint)get_global_id(0);
    if (i >= n)
        return;
    __global const float *g =
        params + (size_t)(i / LAYOUT_LANES) * planes * LAYOUT_LANES + i % LAYOUT_LANES;
    __global float *row = rows + (size_t)i * (3 + len);
    for (uint k = 0; k < 3; k++)
        row[k] = g[k * LAYOUT_LANES];
    for (uint k = 0; k < len; k++)
        row[3 + k] = g[(first + k) * LAYOUT_LANES];
}

__kernel void similarity_add(__global const float *grad, uint n, uint planes, uint first, uint len,
                             float k1, float k2, __global float *m1, __global float *m2)
{
    uint i = (uint)get_global_id(0);
    if (i >= n)
        return;
    size_t at = (size_t)(i / LAYOUT_LANES) * planes * LAYOUT_LANES + i % LAYOUT_LANES;
    for (uint k = 0; k < len; k++) {
        float g = grad[(size_t)i * len + k];
        size_t p = at + (first + k) * LAYOUT_LANES;
        m1[p] = m1[p] + k1 * g;
        m2[p] = m2[p] + k2 * (g * g);
    }
}
