// What skinning does to one Gaussian in one pose, and the gradient of that, of numbers or of vectors
// of them: [R | t] the blended transform row by row, x its mean, S its covariance factor.
//   mean = R x + t,   A = R S,   covariance = A A^T (xx, xy, xz, yy, yz, zz).

#pragma once

#include "each.h"

// A = R S.
template <class T>
FORMULA void factor(const T *rt, const T *s, T *a) {
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k)
            a[3 * i + k] = rt[4 * i] * s[k] + rt[4 * i + 1] * s[3 + k] + rt[4 * i + 2] * s[6 + k];
}

template <class T>
FORMULA void pose_one(const T *rt, const T *x, const T *s, T *m, T *c) {
    T a[9];
    factor(rt, s, a);
    for (int i = 0; i < 3; ++i) {
        m[i] = rt[4 * i] * x[0] + rt[4 * i + 1] * x[1] + rt[4 * i + 2] * x[2] + rt[4 * i + 3];
        for (int k = i; k < 3; ++k)
            *c++ = a[3 * i] * a[3 * k] + a[3 * i + 1] * a[3 * k + 1] + a[3 * i + 2] * a[3 * k + 2];
    }
}

// The gradient of R and t, and what those of x and S gain.
template <class T>
FORMULA void differentiate_one(const T *rt, const T *x, const T *s, const T *gm, const T *gc,
                               T *rt_grad, T *dx, T *ds) {
    // d loss / d A = (G + G^T) A with G the upper triangle of the gradient.
    const T g[9] = {2 * gc[0], gc[1], gc[2], gc[1], 2 * gc[3], gc[4], gc[2], gc[4], 2 * gc[5]};
    T a[9], da[9];
    factor(rt, s, a);
    for (int i = 0; i < 3; ++i)
        for (int k = 0; k < 3; ++k)
            da[3 * i + k] = g[3 * i] * a[k] + g[3 * i + 1] * a[3 + k] + g[3 * i + 2] * a[6 + k];
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k < 3; ++k) {
            rt_grad[4 * i + k] = da[3 * i] * s[3 * k] + da[3 * i + 1] * s[3 * k + 1] +
                                 da[3 * i + 2] * s[3 * k + 2] + gm[i] * x[k];
            dx[k] += rt[4 * i + k] * gm[i];
            for (int c = 0; c < 3; ++c) ds[3 * k + c] += rt[4 * i + k] * da[3 * i + c];
        }
        rt_grad[4 * i + 3] = gm[i];
    }
}
