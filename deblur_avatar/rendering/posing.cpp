// Linear blend skinning of Gaussians in B poses at once, and its gradient; one lane a Gaussian.
//
// For every Gaussian n and pose b, with [R | t] = sum_j weights[n, j] transforms[b, j], what
// posing_formulas.h says.
// A group is as many Gaussians as a vector has lanes (L); only joints of which one of them has a
// weight are blended. So Gaussians of a chunk are placed by the joint that each follows most, and
// their numbers are kept in columns. Chunks have a fixed size, and their sums are added in order:
// results do not depend on the number of threads.

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include "posing_formulas.h"

namespace {

#if defined(__AVX512F__)
constexpr int L = 16;
#elif defined(__AVX__)
constexpr int L = 8;
#else
constexpr int L = 4;
#endif

typedef float vf __attribute__((vector_size(L * 4)));
typedef int32_t vi __attribute__((vector_size(L * 4)));

constexpr int64_t CHUNK = 1024;  // Gaussians; small enough to share out, large enough to amortise
static_assert(CHUNK % L == 0, "chunks are whole groups");

inline bool any(vi mask) {
    uint64_t words[sizeof(vi) / 8], all = 0;
    std::memcpy(words, &mask, sizeof mask);
    for (const uint64_t word : words) all |= word;
    return all != 0;
}

inline float sum(vf x) {
    float lanes[L], total = 0;
    std::memcpy(lanes, &x, sizeof x);
    for (const float lane : lanes) total += lane;
    return total;
}

// K numbers of each of a chunk's Gaussians in their places: group after group, column by column; 0
// where there is no Gaussian.
template <int K>
struct Columns {
    vf values[CHUNK / L][K] = {};

    static int64_t lane(uint32_t place) { return place / L * (L * K) + place % L; }

    void read(const float *rows, const uint32_t *place, int64_t count) {
        for (int64_t n = 0; n < count; ++n, rows += K) {
            float *to = reinterpret_cast<float *>(values) + lane(place[n]);
            for (int k = 0; k < K; ++k) to[k * L] = rows[k];
        }
    }
    void write(float *rows, const uint32_t *place, int64_t count) const {
        for (int64_t n = 0; n < count; ++n, rows += K) {
            const float *from = reinterpret_cast<const float *>(values) + lane(place[n]);
            for (int k = 0; k < K; ++k) rows[k] = from[k * L];
        }
    }
};

// Who poses together, told from the blend weights: of each Gaussian its place in its chunk; of each
// group the joints of which one of its Gaussians has a weight (up to `ends`), and these weights.
struct Groups {
    int64_t joints;
    int64_t *ends;          // [groups]
    int32_t *index;         // [groups, J]
    vf *weights;            // [groups, J]

    // One chunk, whose first group is `base`.
    void fill(int64_t count, const float *rows, uint32_t *place, int64_t base) const {
        std::vector<uint32_t> next(joints + 1);
        for (int64_t n = 0; n < count; ++n) {
            const float *w = rows + n * joints;
            place[n] = static_cast<uint32_t>(std::max_element(w, w + joints) - w);
            ++next[place[n] + 1];
        }
        for (int64_t j = 0; j < joints; ++j) next[j + 1] += next[j];
        const int64_t groups = (count + L - 1) / L;
        std::vector<vf> all(groups * joints);
        float *lanes = reinterpret_cast<float *>(all.data());
        for (int64_t n = 0; n < count; ++n) {
            place[n] = next[place[n]]++;
            float *lane = lanes + place[n] / L * joints * L + place[n] % L;
            for (int64_t j = 0; j < joints; ++j) lane[L * j] = rows[n * joints + j];
        }
        for (int64_t group = 0; group < groups; ++group) {
            int64_t end = (base + group) * joints;
            for (int64_t j = 0; j < joints; ++j) {
                const vf w = all[group * joints + j];
                if (!any(w != 0)) continue;
                index[end] = static_cast<int32_t>(j);
                weights[end++] = w;
            }
            ends[base + group] = end;
        }
    }

    // R and t of a group, row by row; transforms of the pose are `width` numbers apart.
    void blend(int64_t group, const float *pose, int64_t width, vf *rt) const {
        for (int k = 0; k < 12; ++k) rt[k] = vf{};
        for (int64_t a = group * joints; a < ends[group]; ++a) {
            const float *x = pose + index[a] * width;
            for (int k = 0; k < 12; ++k) rt[k] += weights[a] * x[k];
        }
    }

    // What each joint's transform gains from the gradient of R and t.
    void add_gradient(int64_t group, const vf *rt_grad, vf *transform_grads) const {
        for (int64_t a = group * joints; a < ends[group]; ++a) {
            vf *out = transform_grads + 12 * index[a];
            for (int k = 0; k < 12; ++k) out[k] += weights[a] * rt_grad[k];
        }
    }
};

}  // namespace

extern "C" {

int64_t chunks(int64_t gaussians) { return (gaussians + CHUNK - 1) / CHUNK; }

int64_t groups(int64_t gaussians) { return chunks(gaussians) * (CHUNK / L); }

int64_t lanes() { return L; }

// weights [N, J]; places [N], ends [groups], index [groups, J], shared [groups, J, lanes].
void group_by_joint(int64_t gaussians, int64_t joints, int threads, const float *weights,
                    uint32_t *places, int64_t *ends, int32_t *index, float *shared) {
    const Groups all{joints, ends, index, reinterpret_cast<vf *>(shared)};
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t chunk = 0; chunk < chunks(gaussians); ++chunk) {
        const int64_t start = chunk * CHUNK, count = std::min(gaussians - start, CHUNK);
        all.fill(count, weights + start * joints, places + start, start / L);
    }
}

// transforms: [J, B, 12] (already transposed), means [N, 3], covariance_factors [N, 9].
void pose(int64_t poses, int64_t gaussians, int64_t joints, int threads, const float *means,
          const float *covariance_factors, const uint32_t *places, int64_t *ends, int32_t *index,
          float *shared, const float *transforms, float *posed_means, float *posed_covars) {
    const Groups all{joints, ends, index, reinterpret_cast<vf *>(shared)};
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t chunk = 0; chunk < chunks(gaussians); ++chunk) {
        const int64_t start = chunk * CHUNK, count = std::min(gaussians - start, CHUNK);
        const int64_t base = start / L, groups = (count + L - 1) / L;
        const uint32_t *place = places + start;
        struct Numbers {
            Columns<3> x, m;
            Columns<9> s;
            Columns<6> c;
        };
        const auto of = std::make_unique<Numbers>();
        of->x.read(means + 3 * start, place, count);
        of->s.read(covariance_factors + 9 * start, place, count);
        for (int64_t b = 0; b < poses; ++b) {
            for (int64_t group = 0; group < groups; ++group) {
                vf rt[12];
                all.blend(base + group, transforms + 12 * b, 12 * poses, rt);
                pose_one(rt, of->x.values[group], of->s.values[group], of->m.values[group],
                         of->c.values[group]);
            }
            of->m.write(posed_means + 3 * (b * gaussians + start), place, count);
            of->c.write(posed_covars + 6 * (b * gaussians + start), place, count);
        }
    }
}

// Gradients of the same; transforms_grad [J, B, 12] is summed from one partial a chunk.
// weights_grad may be null.
void pose_backward(int64_t poses, int64_t gaussians, int64_t joints, int threads,
                   const float *means, const float *covariance_factors, const uint32_t *places,
                   int64_t *ends, int32_t *index, float *shared, const float *transforms,
                   const float *posed_means_grad,
                   const float *posed_covars_grad, float *means_grad, float *covariance_factors_grad,
                   float *weights_grad, float *partials, float *transforms_grad) {
    const int64_t width = 12 * poses, total = joints * width;
    const Groups all{joints, ends, index, reinterpret_cast<vf *>(shared)};
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t chunk = 0; chunk < chunks(gaussians); ++chunk) {
        const int64_t start = chunk * CHUNK, count = std::min(gaussians - start, CHUNK);
        const int64_t base = start / L, groups = (count + L - 1) / L;
        const uint32_t *place = places + start;
        struct Numbers {
            Columns<3> x, gm, dx;
            Columns<9> s, ds;
            Columns<6> gc;
        };
        const auto of = std::make_unique<Numbers>();
        of->x.read(means + 3 * start, place, count);
        of->s.read(covariance_factors + 9 * start, place, count);
        std::vector<vf> transform_grads(12 * joints);
        std::vector<vf> of_weights(weights_grad ? groups * joints : 0);
        for (int64_t b = 0; b < poses; ++b) {
            of->gm.read(posed_means_grad + 3 * (b * gaussians + start), place, count);
            of->gc.read(posed_covars_grad + 6 * (b * gaussians + start), place, count);
            std::fill(transform_grads.begin(), transform_grads.end(), vf{});
            for (int64_t group = 0; group < groups; ++group) {
                vf rt[12], rt_grad[12];
                all.blend(base + group, transforms + 12 * b, width, rt);
                differentiate_one(rt, of->x.values[group], of->s.values[group],
                                  of->gm.values[group], of->gc.values[group], rt_grad,
                                  of->dx.values[group], of->ds.values[group]);
                all.add_gradient(base + group, rt_grad, transform_grads.data());
                for (int64_t j = 0; weights_grad && j < joints; ++j)
                    for (int k = 0; k < 12; ++k)
                        of_weights[group * joints + j] += transforms[j * width + 12 * b + k] * rt_grad[k];
            }
            for (int64_t j = 0; j < joints; ++j)
                for (int k = 0; k < 12; ++k)
                    partials[chunk * total + j * width + 12 * b + k] = sum(transform_grads[12 * j + k]);
        }
        of->dx.write(means_grad + 3 * start, place, count);
        of->ds.write(covariance_factors_grad + 9 * start, place, count);
        for (int64_t n = 0; weights_grad && n < count; ++n)
            for (int64_t j = 0; j < joints; ++j)
                weights_grad[(start + n) * joints + j] = of_weights[place[n] / L * joints + j][place[n] % L];
    }
    std::memset(transforms_grad, 0, total * sizeof(float));
    for (int64_t chunk = 0; chunk < chunks(gaussians); ++chunk) {
        const float *partial = partials + chunk * total;
#pragma omp simd
        for (int64_t k = 0; k < total; ++k) transforms_grad[k] += partial[k];
    }
}
}
