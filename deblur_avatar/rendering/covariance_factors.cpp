// Rotations times scales of many Gaussians, and their gradients.
//
// For every Gaussian, with t = (1, turn) where there are turns, q = t quat (Hamilton's product):
//   factor = R(q) diag(scales), R(q) the rotation of q / |q|.
// Each Gaussian is on its own, on a CPU or a GPU: results do not depend on the number of threads. Sums of covariance_factors,
// and of the gradients of quats and scales without turns, are not contracted and are in torch's order.

#include "each.h"

namespace {

constexpr float TINY = 1.17549435e-38f;  // added to |q|^2, as torch's twin does

struct Quat {
    float w, x, y, z;
};

// First `b`, then `a`.
FORMULA Quat product(const Quat &a, const Quat &b) {
    return {a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
            a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}

FORMULA float squared_length(const Quat &q) {
    return q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z + TINY;
}

// |q|^2 times the rotation's matrix.
FORMULA void matrix(const Quat &q, float *m) {
    const float ww = q.w * q.w, xx = q.x * q.x, yy = q.y * q.y, zz = q.z * q.z;
    const float wx = q.w * q.x, wy = q.w * q.y, wz = q.w * q.z;
    const float xy = q.x * q.y, xz = q.x * q.z, yz = q.y * q.z;
    m[0] = ww + xx - yy - zz, m[1] = 2 * xy - 2 * wz, m[2] = 2 * wy + 2 * xz;
    m[3] = 2 * wz + 2 * xy, m[4] = ww - xx + yy - zz, m[5] = 2 * yz - 2 * wx;
    m[6] = 2 * xz - 2 * wy, m[7] = 2 * wx + 2 * yz, m[8] = ww - xx - yy + zz;
}

FORMULA Quat turned(const float *quat, const float *turn) {
    const Quat q{quat[0], quat[1], quat[2], quat[3]};
    return turn ? product({1, turn[0], turn[1], turn[2]}, q) : q;
}

}  // namespace

extern "C" {

// quats [N, 4], scales [N, 3], turns [N, 3] or null; covariance_factors [N, 9].
void factors(int64_t gaussians, Place place, const float *quats, const float *scales,
            const float *turns, float *covariance_factors) {
    each(gaussians, place, DO(int64_t n) {
        const Quat q = turned(quats + 4 * n, turns ? turns + 3 * n : nullptr);
        const float squared = squared_length(q), *s = scales + 3 * n;
        float m[9], *out = covariance_factors + 9 * n;
        matrix(q, m);
        for (int k = 0; k < 9; ++k) out[k] = m[k] / squared * s[k % 3];
    });
}

void factors_backward(int64_t gaussians, Place place, const float *quats, const float *scales,
                     const float *turns, const float *covariance_factors_grad, float *quats_grad,
                     float *scales_grad, float *turns_grad) {
    each(gaussians, place, DO(int64_t n) {
        const Quat q = turned(quats + 4 * n, turns ? turns + 3 * n : nullptr);
        const float squared = squared_length(q), *s = scales + 3 * n, *g = covariance_factors_grad + 9 * n;
        float m[9], d[9], t[9];
        matrix(q, m);
        for (int k = 0; k < 3; ++k) {
            float sum = 0;
            for (int i = 0; i < 3; ++i) sum += g[3 * i + k] * (m[3 * i + k] / squared);
            scales_grad[3 * n + k] = sum;
        }
        // Of the matrix before it is divided, and of the divisor.
        for (int k = 0; k < 9; ++k) {
            const float of_matrix = g[k] * s[k % 3];
            d[k] = of_matrix / squared;
            t[k] = -of_matrix * (m[k] / squared / squared);
        }
        float of_squared = t[8];
        for (int k = 0; k < 8; ++k) of_squared += t[k];
        // Of the products of two entries, each of which is taken in one order only.
        const float ww = d[0] + d[4] + d[8], xx = d[0] - d[4] - d[8], yy = -d[0] + d[4] - d[8],
                    zz = -d[0] - d[4] + d[8];
        const float wx = -2 * d[5] + 2 * d[7], wy = 2 * d[2] - 2 * d[6], wz = -2 * d[1] + 2 * d[3];
        const float xy = 2 * d[1] + 2 * d[3], xz = 2 * d[2] + 2 * d[6], yz = 2 * d[5] + 2 * d[7];
        const Quat first{ww * q.w + wx * q.x + wy * q.y + wz * q.z,
                         xx * q.x + xy * q.y + xz * q.z, yy * q.y + yz * q.z, zz * q.z};
        const Quat second{ww * q.w, wx * q.w + xx * q.x, wy * q.w + xy * q.x + yy * q.y,
                          wz * q.w + xz * q.x + yz * q.y + zz * q.z};
        const Quat of_quat{first.w + second.w + of_squared * (2 * q.w),
                           first.x + second.x + of_squared * (2 * q.x),
                           first.y + second.y + of_squared * (2 * q.y),
                           first.z + second.z + of_squared * (2 * q.z)};
        float *out = quats_grad + 4 * n;
        if (!turns) {
            out[0] = of_quat.w, out[1] = of_quat.x, out[2] = of_quat.y, out[3] = of_quat.z;
            return;
        }
        // The product is linear in both; multiplying by a conjugate is the transpose.
        const float *u = turns + 3 * n, *p = quats + 4 * n;
        const Quat before = product({1, -u[0], -u[1], -u[2]}, of_quat);
        const Quat turn = product(of_quat, {p[0], -p[1], -p[2], -p[3]});
        out[0] = before.w, out[1] = before.x, out[2] = before.y, out[3] = before.z;
        float *of_turn = turns_grad + 3 * n;
        of_turn[0] = turn.x, of_turn[1] = turn.y, of_turn[2] = turn.z;
    });
}

// covariance_factors [N, 9]; covars [N, 6]: xx, xy, xz, yy, yz, zz of factor factor^T.
void covariances(int64_t gaussians, Place place, const float *covariance_factors, float *covars) {
    each(gaussians, place, DO(int64_t n) {
        const float *a = covariance_factors + 9 * n;
        float *c = covars + 6 * n;
        for (int i = 0; i < 3; ++i)
            for (int k = i; k < 3; ++k)
                *c++ = a[3 * i] * a[3 * k] + a[3 * i + 1] * a[3 * k + 1] +
                       a[3 * i + 2] * a[3 * k + 2];
    });
}

void covariances_backward(int64_t gaussians, Place place, const float *covariance_factors,
                          const float *covars_grad, float *covariance_factors_grad) {
    each(gaussians, place, DO(int64_t n) {
        const float *a = covariance_factors + 9 * n, *c = covars_grad + 6 * n;
        const float g[9] = {2 * c[0], c[1], c[2], c[1], 2 * c[3], c[4], c[2], c[4], 2 * c[5]};
        float *out = covariance_factors_grad + 9 * n;
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 3; ++k)
                out[3 * i + k] = g[3 * i] * a[k] + g[3 * i + 1] * a[3 + k] + g[3 * i + 2] * a[6 + k];
    });
}
}
