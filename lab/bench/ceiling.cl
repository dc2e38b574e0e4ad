// The machine's ceilings. fma: independent chains of multiply-adds, nothing but arithmetic. triad:
// a = b + s * c over arrays far larger than any cache. VW 16 (CPUs): 12 chains of float16, and a
// work-item walks a piece of the arrays. VW 1 (GPUs): 12 chains of float4, and a work-item has
// every 256th float4 of a piece, so that neighbours read neighbouring words.
//
// SPDX-License-Identifier: Apache-2.0
#if VW == 16
typedef float16 W;
#define STORE(x, p) vstore16(x, get_global_id(0), p)
#else
typedef float4 W;
#define STORE(x, p) vstore4(x, get_global_id(0), p)
#endif

__kernel void ceiling_fma(__global float *out, const float x, const int rounds)
{
    W a[12];
    const W m = (W)(0.999f + x * 1e-9f), c = (W)(1e-3f);
    for (int k = 0; k < 12; k++)
        a[k] = (W)((float)k + x);
    for (int i = 0; i < rounds; i++) {
        a[0] = a[0] * m + c;
        a[1] = a[1] * m + c;
        a[2] = a[2] * m + c;
        a[3] = a[3] * m + c;
        a[4] = a[4] * m + c;
        a[5] = a[5] * m + c;
        a[6] = a[6] * m + c;
        a[7] = a[7] * m + c;
        a[8] = a[8] * m + c;
        a[9] = a[9] * m + c;
        a[10] = a[10] * m + c;
        a[11] = a[11] * m + c;
    }
    W s = a[0];
    for (int k = 1; k < 12; k++)
        s += a[k];
    STORE(s, out);
}

// chunk: vectors of a work-item.
__kernel void ceiling_triad(__global float *a, __global const float *b, __global const float *c,
                            const float s, const int chunk)
{
#if VW == 16
    const int first = get_global_id(0) * chunk;
    for (int i = first; i < first + chunk; i++)
        vstore16(vload16(i, b) + s * vload16(i, c), i, a);
#else
    const int stride = get_local_size(0);
    int at = get_group_id(0) * stride * chunk + get_local_id(0);
    for (int i = 0; i < chunk; i++, at += stride)
        vstore4(vload4(at, b) + s * vload4(at, c), at, a);
#endif
}
