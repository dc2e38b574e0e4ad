/* Small symmetric positive definite systems, in place.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/cholesky.h"

#include <math.h>

#define CHOLESKY_DIGITS 1e-13

bool cholesky_factor(double *a, size_t n, size_t stride)
{
    for (size_t j = 0; j < n; j++) {
        double *row = a + j * stride, pivot = row[j], full = pivot;
        for (size_t k = 0; k < j; k++)
            pivot -= row[k] * row[k];
        if (!(pivot > CHOLESKY_DIGITS * full))
            return false;
        row[j] = sqrt(pivot);
        for (size_t i = j + 1; i < n; i++) {
            double *below = a + i * stride, v = below[j];
            for (size_t k = 0; k < j; k++)
                v -= below[k] * row[k];
            below[j] = v / row[j];
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
