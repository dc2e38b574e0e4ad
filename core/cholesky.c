/* Small symmetric positive definite systems, in place.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/cholesky.h"

#include <math.h>

#include "core/simd.h"

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

SIMD_WIDE void cholesky_solve_sides(const double *l, size_t n, size_t stride,
                                    double (*x)[CHOLESKY_SIDES])
{
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < i; k++)
            for (size_t side = 0; side < CHOLESKY_SIDES; side++)
                x[i][side] -= l[i * stride + k] * x[k][side];
        for (size_t side = 0; side < CHOLESKY_SIDES; side++)
            x[i][side] /= l[i * stride + i];
    }
    for (size_t i = n; i-- > 0;) {
        for (size_t k = i + 1; k < n; k++)
            for (size_t side = 0; side < CHOLESKY_SIDES; side++)
                x[i][side] -= l[k * stride + i] * x[k][side];
        for (size_t side = 0; side < CHOLESKY_SIDES; side++)
            x[i][side] /= l[i * stride + i];
    }
}
