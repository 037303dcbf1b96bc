// Linear blend skinning of Gaussians in B poses at once, and its gradient, given the blends: what
// posing_formulas.h says, of every Gaussian n and pose b.

#include "posing_formulas.h"

extern "C" {

// blended [N, B, 12]; means [N, 3], covariance_factors [N, 9]; posed: [B, N, 3] and [B, N, 6].
void pose(int64_t poses, int64_t gaussians, Place place, const float *means,
          const float *covariance_factors, const float *blended, float *posed_means,
          float *posed_covars) {
    each(gaussians * poses, place, DO(int64_t i) {
        const int64_t n = i / poses, out = i % poses * gaussians + n;
        pose_one(blended + 12 * i, means + 3 * n, covariance_factors + 9 * n,
                 posed_means + 3 * out, posed_covars + 6 * out);
    });
}

// Gradients of the same.
void pose_backward(int64_t poses, int64_t gaussians, Place place, const float *means,
                   const float *covariance_factors, const float *blended,
                   const float *posed_means_grad, const float *posed_covars_grad,
                   float *means_grad, float *covariance_factors_grad, float *blended_grad) {
    each(gaussians, place, DO(int64_t n) {
        float dx[3] = {}, ds[9] = {};
        for (int64_t b = 0; b < poses; ++b) {
            const int64_t i = 12 * (n * poses + b), out = b * gaussians + n;
            differentiate_one(blended + i, means + 3 * n, covariance_factors + 9 * n,
                              posed_means_grad + 3 * out, posed_covars_grad + 6 * out,
                              blended_grad + i, dx, ds);
        }
        for (int k = 0; k < 3; ++k) means_grad[3 * n + k] = dx[k];
        for (int k = 0; k < 9; ++k) covariance_factors_grad[9 * n + k] = ds[k];
    });
}
}
