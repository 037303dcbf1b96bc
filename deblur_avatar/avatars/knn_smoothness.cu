// How much Gaussians differ from their nearest neighbours, and its gradient: what knn_smoothness.cpp
// says, one number of a Gaussian at a time. Signs are counted in whole numbers: gradients do not
// depend on who counts first.

#include <cmath>

#include "../rendering/each.h"

extern "C" {

// values [N, D], near [N, K]; total and counts [N, D], both zeros; loss; grad [N, D]. A neighbour
// that there is not makes the loss not a number.
void knn_smoothness(int64_t gaussians, int64_t width, int64_t neighbours, Place place,
                    const float *values, const int64_t *near, double *total, int32_t *counts,
                    float *loss, float *grad) {
    const int64_t size = gaussians * width;
    each_sum<1>(size, place, total, DO(int64_t i, double *sum) {
        const int64_t n = i / width, d = i % width;
        const float own = values[i];
        int32_t own_count = 0;
        for (int64_t k = 0; k < neighbours; ++k) {
            const int64_t other = near[n * neighbours + k];
            if (other < 0 || other >= gaussians) {
                sum[0] = NAN;
                return;
            }
            const float apart = values[other * width + d] - own;
            sum[0] += fabsf(apart);
            const int32_t sign = (apart > 0) - (apart < 0);
            if (sign) add_whole(counts + other * width + d, sign);
            own_count -= sign;
        }
        if (own_count) add_whole(counts + i, own_count);
    });
    const int64_t differences = size * neighbours;
    const double share = 1.0 / (differences > 0 ? differences : 1);
    each(size, place, DO(int64_t i) { grad[i] = static_cast<float>(share * counts[i]); });
    each(1, place, DO(int64_t) { *loss = static_cast<float>(*total * share); });
}
}
