// Linear blend skinning of Gaussians in B poses at once, and its gradient.
//
// For every Gaussian n and pose b, with [R | t] = sum_j weights[n, j] transforms[b, j]:
//   mean = R x + t,   A = R S,   covariance = A A^T (xx, xy, xz, yy, yz, zz).
// The blend of all B poses is one row of 12 B numbers, so that its loops are long and straight.
// Gaussians are worked on in chunks of fixed size whose sums are added in order: results do not
// depend on the number of threads.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <vector>

namespace {

constexpr int64_t CHUNK = 256;  // Gaussians; small enough to share out, large enough to amortise

struct Row {
    const float *r;  // 3 x 4, row-major: R and t
    float at(int i, int k) const { return r[4 * i + k]; }
};

// One Gaussian's blend of all poses' transforms [J, width], into a row of that width.
inline void blend_transforms(int64_t joints, int64_t width, const float *weights,
                             const float *transforms, float *row) {
    std::memset(row, 0, width * sizeof(float));
    for (int64_t j = 0; j < joints; ++j) {
        const float w = weights[j];
        if (w == 0) continue;  // most joints, where weights are a body's own
        const float *x = transforms + j * width;
#pragma omp simd
        for (int64_t k = 0; k < width; ++k) row[k] += w * x[k];
    }
}

}  // namespace

extern "C" {

int64_t chunks(int64_t gaussians) { return (gaussians + CHUNK - 1) / CHUNK; }

// transforms: [J, B, 12] (already transposed), means [N, 3], covariance_factors [N, 9], weights [N, J].
void pose(int64_t poses, int64_t gaussians, int64_t joints, int threads, const float *means,
          const float *covariance_factors, const float *weights, const float *transforms, float *posed_means,
          float *posed_covars) {
    const int64_t width = 12 * poses;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t chunk = 0; chunk < chunks(gaussians); ++chunk) {
        std::vector<float> blend(width);
        const int64_t last = std::min(gaussians, (chunk + 1) * CHUNK);
        for (int64_t n = chunk * CHUNK; n < last; ++n) {
            float *row = blend.data();
            blend_transforms(joints, width, weights + n * joints, transforms, row);
            const float *x = means + 3 * n, *s = covariance_factors + 9 * n;
            for (int64_t b = 0; b < poses; ++b) {
                const Row t{row + 12 * b};
                float a[3][3];
                float *m = posed_means + 3 * (b * gaussians + n);
                for (int i = 0; i < 3; ++i) {
                    m[i] = t.at(i, 0) * x[0] + t.at(i, 1) * x[1] + t.at(i, 2) * x[2] + t.at(i, 3);
                    for (int k = 0; k < 3; ++k)
                        a[i][k] = t.at(i, 0) * s[k] + t.at(i, 1) * s[3 + k] + t.at(i, 2) * s[6 + k];
                }
                float *c = posed_covars + 6 * (b * gaussians + n);
                int e = 0;
                for (int i = 0; i < 3; ++i)
                    for (int k = i; k < 3; ++k)
                        c[e++] = a[i][0] * a[k][0] + a[i][1] * a[k][1] + a[i][2] * a[k][2];
            }
        }
    }
}

// Gradients of the same; transforms_grad [J, B, 12] is summed from one partial a chunk. Without
// weights_grad, which may be null, joints of no weight are passed over.
void pose_backward(int64_t poses, int64_t gaussians, int64_t joints, int threads,
                   const float *means, const float *covariance_factors, const float *weights,
                   const float *transforms, const float *posed_means_grad,
                   const float *posed_covars_grad, float *means_grad, float *covariance_factors_grad,
                   float *weights_grad, float *partials, float *transforms_grad) {
    const int64_t width = 12 * poses, total = joints * width;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t chunk = 0; chunk < chunks(gaussians); ++chunk) {
        std::vector<float> blend(width), blend_grad(width);
        float *partial = partials + chunk * total;
        std::memset(partial, 0, total * sizeof(float));
        const int64_t last = std::min(gaussians, (chunk + 1) * CHUNK);
        for (int64_t n = chunk * CHUNK; n < last; ++n) {
            float *row = blend.data(), *back = blend_grad.data();
            blend_transforms(joints, width, weights + n * joints, transforms, row);
            const float *x = means + 3 * n, *s = covariance_factors + 9 * n;
            float dx[3] = {0, 0, 0}, ds[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
            for (int64_t b = 0; b < poses; ++b) {
                const Row t{row + 12 * b};
                const float *gm = posed_means_grad + 3 * (b * gaussians + n);
                const float *gc = posed_covars_grad + 6 * (b * gaussians + n);
                // d loss / d A = (G + G^T) A with G the upper triangle of the gradient.
                const float g[3][3] = {{2 * gc[0], gc[1], gc[2]},
                                       {gc[1], 2 * gc[3], gc[4]},
                                       {gc[2], gc[4], 2 * gc[5]}};
                float a[3][3], da[3][3];
                for (int i = 0; i < 3; ++i)
                    for (int k = 0; k < 3; ++k)
                        a[i][k] = t.at(i, 0) * s[k] + t.at(i, 1) * s[3 + k] + t.at(i, 2) * s[6 + k];
                for (int i = 0; i < 3; ++i)
                    for (int k = 0; k < 3; ++k)
                        da[i][k] = g[i][0] * a[0][k] + g[i][1] * a[1][k] + g[i][2] * a[2][k];
                float *d = back + 12 * b;
                for (int i = 0; i < 3; ++i) {
                    for (int k = 0; k < 3; ++k) {
                        d[4 * i + k] = da[i][0] * s[3 * k] + da[i][1] * s[3 * k + 1] +
                                       da[i][2] * s[3 * k + 2] + gm[i] * x[k];
                        dx[k] += t.at(i, k) * gm[i];
                        for (int c = 0; c < 3; ++c) ds[3 * k + c] += t.at(i, k) * da[i][c];
                    }
                    d[4 * i + 3] = gm[i];
                }
            }
            std::memcpy(means_grad + 3 * n, dx, sizeof dx);
            std::memcpy(covariance_factors_grad + 9 * n, ds, sizeof ds);
            for (int64_t j = 0; j < joints; ++j) {
                const float w = weights[n * joints + j];
                if (w == 0 && !weights_grad) continue;
                const float *x = transforms + j * width;
                float *out = partial + j * width;
                float sum = 0;
#pragma omp simd reduction(+ : sum)
                for (int64_t k = 0; k < width; ++k) {
                    sum += x[k] * back[k];
                    out[k] += w * back[k];
                }
                if (weights_grad) weights_grad[n * joints + j] = sum;
            }
        }
    }
    std::memset(transforms_grad, 0, total * sizeof(float));
    for (int64_t chunk = 0; chunk < chunks(gaussians); ++chunk) {
        const float *partial = partials + chunk * total;
#pragma omp simd
        for (int64_t k = 0; k < total; ++k) transforms_grad[k] += partial[k];
    }
}
}
