/* Small symmetric positive definite systems, in place.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/math/cholesky.h"

#include <math.h>
#include <string.h>

#include "core/math/simd.h"

#define CHOLESKY_DIGITS 1e-13

/* One column after the other; what it explains is taken from the rows below at once, so that the
 * inner loop runs along rows. */
SIMD_WIDE bool cholesky_factor(double *a, size_t n, size_t stride)
{
    double last = n ? a[(n - 1) * stride + n - 1] : 0.0;
    for (size_t k = 0; k + 1 < n; k++) /* the diagonal as it was, beside its place */
        a[k * stride + k + 1] = a[k * stride + k];
    for (size_t k = 0; k < n; k++) {
        double *row = a + k * stride, full = k + 1 < n ? row[k + 1] : last;
        if (!(row[k] > CHOLESKY_DIGITS * full))
            return false;
        row[k] = sqrt(row[k]);
        for (size_t i = k + 1; i < n; i++)
            row[i] = a[i * stride + k] /= row[k];
        for (size_t i = k + 1; i < n; i++) {
            double *below = a + i * stride, v = below[k];
            for (size_t j = k + 1; j <= i; j++)
                below[j] -= v * row[j];
        }
    }
    return true;
}

void cholesky_solve(const double *l, size_t n, size_t stride, const double *b, double *x)
{
    for (size_t i = 0; i < n; i++) {
        double v = b[i];
        for (size_t k = 0; k < i; k++)
            v -= l[i * stride + k] * x[k];
        x[i] = v / l[i * stride + i];
    }
    for (size_t i = n; i-- > 0;) {
        for (size_t k = i + 1; k < n; k++)
            x[i] -= l[k * stride + i] * x[k];
        x[i] /= l[i * stride + i];
    }
}

/* ---- lanes ---- */

/* x -= v y. What is read is copied first: the compiler cannot know that it is not what is written.
 */
SIMD_INLINE void cholesky_take(double x[CHOLESKY_LANES], const double v[CHOLESKY_LANES],
                               const double y[CHOLESKY_LANES])
{
    double by[CHOLESKY_LANES];
    for (size_t l = 0; l < CHOLESKY_LANES; l++)
        by[l] = v[l] * y[l];
    for (size_t l = 0; l < CHOLESKY_LANES; l++)
        x[l] -= by[l];
}

SIMD_INLINE void cholesky_divide(double x[CHOLESKY_LANES], const double by[CHOLESKY_LANES])
{
    double out[CHOLESKY_LANES];
    for (size_t l = 0; l < CHOLESKY_LANES; l++)
        out[l] = x[l] / by[l];
    memcpy(x, out, sizeof out);
}

SIMD_WIDE void cholesky_factor_lanes(double (*a)[CHOLESKY_LANES], size_t n, size_t stride,
                                     bool ok[CHOLESKY_LANES])
{
    double full[CHOLESKY_LANES_N][CHOLESKY_LANES], column[CHOLESKY_LANES_N][CHOLESKY_LANES];
    for (size_t k = 0; k < n; k++)
        memcpy(full[k], a[k * stride + k], sizeof full[k]);
    for (size_t l = 0; l < CHOLESKY_LANES; l++)
        ok[l] = true;
    for (size_t k = 0; k < n; k++) {
        double *diagonal = a[k * stride + k];
        for (size_t l = 0; l < CHOLESKY_LANES; l++)
            ok[l] &= diagonal[l] > CHOLESKY_DIGITS * full[k][l];
        for (size_t l = 0; l < CHOLESKY_LANES; l++)
            diagonal[l] = sqrt(diagonal[l]);
        for (size_t i = k + 1; i < n; i++) {
            cholesky_divide(a[i * stride + k], diagonal);
            memcpy(column[i], a[i * stride + k], sizeof column[i]);
        }
        for (size_t i = k + 1; i < n; i++)
            for (size_t j = k + 1; j <= i; j++)
                cholesky_take(a[i * stride + j], column[i], column[j]);
    }
}

SIMD_WIDE void cholesky_solve_lanes(double (*l)[CHOLESKY_LANES], size_t n, size_t stride,
                                    double (*x)[CHOLESKY_RIGHT][CHOLESKY_LANES])
{
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < i; k++)
            for (size_t side = 0; side < CHOLESKY_RIGHT; side++)
                cholesky_take(x[i][side], l[i * stride + k], x[k][side]);
        for (size_t side = 0; side < CHOLESKY_RIGHT; side++)
            cholesky_divide(x[i][side], l[i * stride + i]);
    }
    for (size_t i = n; i-- > 0;) {
        for (size_t k = i + 1; k < n; k++)
            for (size_t side = 0; side < CHOLESKY_RIGHT; side++)
                cholesky_take(x[i][side], l[k * stride + i], x[k][side]);
        for (size_t side = 0; side < CHOLESKY_RIGHT; side++)
            cholesky_divide(x[i][side], l[i * stride + i]);
    }
}
