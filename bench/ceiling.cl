// The machine's ceilings. fma: 16 independent chains of float16 multiply-adds a work-item, nothing
// but arithmetic. triad: a = b + s * c over arrays far larger than any cache.
//
// SPDX-License-Identifier: Apache-2.0
__kernel void ceiling_fma(__global float *out, const float x, const int rounds)
{
    float16 a[12];
    const float16 m = (float16)(0.999f + x * 1e-9f), c = (float16)(1e-3f);
    for (int k = 0; k < 12; k++)
        a[k] = (float16)((float)k + x);
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
    float16 s = a[0];
    for (int k = 1; k < 12; k++)
        s += a[k];
    vstore16(s, get_global_id(0), out);
}

__kernel void ceiling_triad(__global float *a, __global const float *b, __global const float *c,
                            const float s, const int chunk)
{
    const int first = get_global_id(0) * chunk;
    for (int i = first; i < first + chunk; i++)
        vstore16(vload16(i, b) + s * vload16(i, c), i, a);
}
