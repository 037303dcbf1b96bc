// How far neighbours are from keeping the distances of their values in a pose, and its gradients.
//
// With s(v; n, k) = |v[near[n, k]] - v[n]|, not less than the root of the smallest number:
//   loss = mean over n, k of |s(canonical; n, k) - s(posed; n, k)|.
// One thread in one order: a few tenths of a millisecond are not worth sharing out.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <type_traits>

namespace {

enum Problem { NONE = 0, NOT_FINITE = 1, NO_SUCH_NEIGHBOUR = 2 };

// NaN or infinite, told from the bits: comparisons may be compiled as if neither existed.
inline bool odd(float x) {
    uint32_t bits;
    std::memcpy(&bits, &x, sizeof bits);
    return (bits & 0x7f800000) == 0x7f800000;
}

inline float squared_distance(int64_t width, const float *one, const float *other) {
    float sum = 0;
    for (int64_t d = 0; d < width; ++d) sum += (other[d] - one[d]) * (other[d] - one[d]);
    return sum;
}

inline float spacing(float squared) {
    return std::sqrt(std::max(squared, std::numeric_limits<float>::min()));
}

// Add the gradient of `slope` times a distance: along the difference, to both of its ends.
inline void add_distance_grad(int64_t width, float slope, const float *one, const float *other,
                     float *one_grad, float *other_grad) {
    for (int64_t d = 0; d < width; ++d) {
        const float push = (other[d] - one[d]) * slope;
        other_grad[d] += push;
        one_grad[d] -= push;
    }
}

// Inlined once for each common width, so that the loops over columns are unrolled.
[[gnu::always_inline]] inline int run(int64_t gaussians, int64_t width, int64_t neighbours,
                                      const float *canonical, const float *posed,
                                      const int64_t *near, float *loss, float *canonical_grad,
                                      float *posed_grad) {
    const int64_t pairs = std::max<int64_t>(gaussians * neighbours, 1);
    const float share = 1.0f / pairs;
    double total = 0;
    bool bad = false;
    for (int64_t n = 0; n < gaussians; ++n) {
        for (int64_t k = 0; k < neighbours; ++k) {
            const int64_t other = near[n * neighbours + k];
            if (other < 0 || other >= gaussians) return NO_SUCH_NEIGHBOUR;
            const int64_t i = width * n, j = width * other;
            const float before = squared_distance(width, canonical + i, canonical + j);
            const float after = squared_distance(width, posed + i, posed + j);
            bad |= odd(before) | odd(after);
            const float s = spacing(before), t = spacing(after);
            const float apart = s - t;
            total += std::fabs(apart);
            const float slope = apart == 0 ? 0 : std::copysign(share, apart);
            if (canonical_grad)
                add_distance_grad(width, slope / s, canonical + i, canonical + j, canonical_grad + i,
                         canonical_grad + j);
            if (posed_grad)
                add_distance_grad(width, -slope / t, posed + i, posed + j, posed_grad + i, posed_grad + j);
        }
    }
    *loss = static_cast<float>(total / pairs);
    return bad ? NOT_FINITE : NONE;
}

}  // namespace

extern "C" {

// canonical, posed: [N, D]; near: [N, K]. Gradients [N, D] come as zeros and may be null. Returns
// what is wrong (Problem): a distance that is not finite, or a neighbour that there is not.
int isometry(int64_t gaussians, int64_t width, int64_t neighbours, const float *canonical,
             const float *posed, const int64_t *near, float *loss, float *canonical_grad,
             float *posed_grad) {
    const auto with = [&](auto columns) {
        return run(gaussians, columns, neighbours, canonical, posed, near, loss, canonical_grad,
                   posed_grad);
    };
    if (width == 3) return with(std::integral_constant<int64_t, 3>());
    if (width == 6) return with(std::integral_constant<int64_t, 6>());
    return with(width);
}
}
