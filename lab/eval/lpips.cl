/* Stage: forward pass of a convolutional network, and LPIPS distances between its features.
 *
 *   maps     float [channels][height + 2 LAYOUT_LPIPS_ROWS][pitch], with
 *            pitch = 2 LAYOUT_LPIPS_MARGIN + round_up(width, 16): pixel (x, y) at
 *            (y + LAYOUT_LPIPS_ROWS) * pitch + LAYOUT_LPIPS_MARGIN + x; zero outside the picture,
 *            which is the padding of convolutions
 *   weights  float [ceil(cout / 8)][cin][k][k][8]; bias float [8 ceil(cout / 8)]
 *
 * One work-item = VW pixels of a row times 8 output channels (convolution of stride 1), one pixel
 * otherwise. Reference: the plain loops of tests/lab/test_lpips.c. Tolerance: float rounding,
 * 1e-4 relative.
 */
#if VW == 16
typedef float16 V;
#define LOAD(p) vload16(0, (p))
#define STORE(v, p) vstore16((v), 0, (p))
#else
typedef float V;
#define LOAD(p) (*(p))
#define STORE(v, p) (*(p) = (v))
#endif

/* A map: its size and where its pixel (0, 0) lies. */
struct map {
    int w, h, pitch, plane;
};

static struct map map_of(int w, int h)
{
    struct map m;
    m.w = w;
    m.h = h;
    m.pitch = 2 * LAYOUT_LPIPS_MARGIN + (w + 15) / 16 * 16;
    m.plane = (h + 2 * LAYOUT_LPIPS_ROWS) * m.pitch;
    return m;
}

static int map_at(struct map m, int c, int x, int y)
{
    return c * m.plane + (y + LAYOUT_LPIPS_ROWS) * m.pitch + LAYOUT_LPIPS_MARGIN + x;
}

/* Stride 1: out = max(0, bias + sum of weights * in). */
__kernel void lpips_conv(__global const float *restrict in, __global const float *restrict weights,
                         __global const float *restrict bias, __global float *restrict out, int cin,
                         int cout, int k, int pad, int w, int h, int w_out, int h_out)
{
    struct map from = map_of(w, h), to = map_of(w_out, h_out);
    int blocks = (w_out + VW - 1) / VW, at = (int)get_global_id(0);
    int x = at % blocks * VW, y = at / blocks % h_out, group = at / blocks / h_out;
    if (group * LAYOUT_LPIPS_CHANNELS >= cout)
        return;
    __global const float *restrict f =
        weights + (size_t)group * cin * k * k * LAYOUT_LPIPS_CHANNELS;
    V sum[LAYOUT_LPIPS_CHANNELS];
#pragma unroll
    for (int j = 0; j < LAYOUT_LPIPS_CHANNELS; j++)
        sum[j] = (V)(bias[group * LAYOUT_LPIPS_CHANNELS + j]);
    for (int c = 0; c < cin; c++)
        for (int i = 0; i < k; i++) {
            __global const float *restrict row = in + map_at(from, c, x - pad, y - pad + i);
            for (int n = 0; n < k; n++, f += LAYOUT_LPIPS_CHANNELS) {
                V v = LOAD(row + n);
#pragma unroll
                for (int j = 0; j < LAYOUT_LPIPS_CHANNELS; j++)
                    sum[j] += v * f[j];
            }
        }
    for (int j = 0; j < LAYOUT_LPIPS_CHANNELS && group * LAYOUT_LPIPS_CHANNELS + j < cout; j++) {
        V v = max(sum[j], (V)(0.0f));
        __global float *o = out + map_at(to, group * LAYOUT_LPIPS_CHANNELS + j, x, y);
#if VW == 16
        if (x + VW > w_out) { /* beyond the picture stays zero */
            float lane[VW];
            vstore16(v, 0, lane);
            for (int n = 0; n < w_out - x; n++)
                o[n] = lane[n];
            continue;
        }
#endif
        STORE(v, o);
    }
}

/* Any stride, a pixel at a time. */
__kernel void lpips_conv_stride(__global const float *restrict in,
                                __global const float *restrict weights,
                                __global const float *restrict bias, __global float *restrict out,
                                int cin, int cout, int k, int pad, int w, int h, int w_out,
                                int h_out, int stride)
{
    struct map from = map_of(w, h), to = map_of(w_out, h_out);
    int at = (int)get_global_id(0), x = at % w_out, y = at / w_out % h_out;
    int group = at / w_out / h_out;
    if (group * LAYOUT_LPIPS_CHANNELS >= cout)
        return;
    __global const float *restrict f =
        weights + (size_t)group * cin * k * k * LAYOUT_LPIPS_CHANNELS;
    float sum[LAYOUT_LPIPS_CHANNELS];
    for (int j = 0; j < LAYOUT_LPIPS_CHANNELS; j++)
        sum[j] = bias[group * LAYOUT_LPIPS_CHANNELS + j];
    for (int c = 0; c < cin; c++)
        for (int i = 0; i < k; i++)
            for (int n = 0; n < k; n++, f += LAYOUT_LPIPS_CHANNELS) {
                float v = in[map_at(from, c, x * stride - pad + n, y * stride - pad + i)];
                for (int j = 0; j < LAYOUT_LPIPS_CHANNELS; j++)
                    sum[j] += v * f[j];
            }
    for (int j = 0; j < LAYOUT_LPIPS_CHANNELS && group * LAYOUT_LPIPS_CHANNELS + j < cout; j++)
        out[map_at(to, group * LAYOUT_LPIPS_CHANNELS + j, x, y)] = max(sum[j], 0.0f);
}

/* Maximum over k x k pixels, windows inside the picture alone. */
__kernel void lpips_pool(__global const float *restrict in, __global float *restrict out,
                         int channels, int k, int w, int h, int w_out, int h_out, int stride)
{
    struct map from = map_of(w, h), to = map_of(w_out, h_out);
    int at = (int)get_global_id(0), x = at % w_out, y = at / w_out % h_out;
    int c = at / w_out / h_out;
    if (c >= channels)
        return;
    float best = 0.0f; /* what comes in went through max(0, .) */
    for (int i = 0; i < k; i++)
        for (int n = 0; n < k; n++)
            best = max(best, in[map_at(from, c, x * stride + n, y * stride + i)]);
    out[map_at(to, c, x, y)] = best;
}

/* sum_c weight_c (a_c / |a| - b_c / |b|)^2 at every pixel; distance float [h][w]. */
__kernel void lpips_distance(__global const float *restrict a, __global const float *restrict b,
                             __global const float *restrict weights,
                             __global float *restrict distance, int channels, int w, int h)
{
    struct map m = map_of(w, h);
    int at = (int)get_global_id(0), x = at % w, y = at / w;
    if (y >= h)
        return;
    float aa = 0.0f, bb = 0.0f, sum = 0.0f;
    for (int c = 0; c < channels; c++) {
        float p = a[map_at(m, c, x, y)], q = b[map_at(m, c, x, y)];
        aa += p * p;
        bb += q * q;
    }
    float na = 1.0f / (sqrt(aa) + 1e-10f), nb = 1.0f / (sqrt(bb) + 1e-10f);
    for (int c = 0; c < channels; c++) {
        float d = a[map_at(m, c, x, y)] * na - b[map_at(m, c, x, y)] * nb;
        sum += weights[c] * d * d;
    }
    distance[at] = sum;
}
