// How much Gaussians differ from their nearest neighbours, and its gradient.
//
//   loss = mean over n, k, d of |v[near[n, k], d] - v[n, d]|.
// The gradient of a value is a whole number of signs times 1 / (N K D). Whole numbers add up alike
// in any order: each thread has counts of its own. Of the loss, each block of Gaussians has its own
// sum, added in their order: results do not depend on the number of threads.
//
// Columns are padded with zeros to whole vectors, which differ by nothing.

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstring>
#include <vector>

#ifdef _OPENMP
#include <omp.h>
#endif

namespace {

enum Problem { NONE = 0, NO_SUCH_NEIGHBOUR = 1 };

constexpr int64_t BLOCK = 4096;  // Gaussians
constexpr int64_t L = 4;         // columns of a vector: avatars have 1 to 4

typedef float vf __attribute__((vector_size(L * 4)));
typedef int32_t vi __attribute__((vector_size(L * 4)));

inline vf abs(vf x) { return (vf)((vi)x & 0x7fffffff); }

inline int thread() {
#ifdef _OPENMP
    return omp_get_thread_num();
#else
    return 0;
#endif
}

// Gaussians first to last of N with M vectors each, values [N, M]: their sum of differences, not
// finite where one is not. Counts [N, M], which may be null, gain the signs.
double differences(int64_t first, int64_t last, int64_t gaussians, int64_t vectors,
                   int64_t neighbours, const vf *values, const int64_t *near, vi *counts,
                   std::atomic<int> &problem) {
    double total = 0;
    for (int64_t n = first; n < last; ++n) {
        for (int64_t v = 0; v < vectors; ++v) {
            const vf own = values[n * vectors + v];
            vf sum{};
            vi own_count{};
            for (int64_t k = 0; k < neighbours; ++k) {
                const int64_t other = near[n * neighbours + k];
                if (other < 0 || other >= gaussians) {
                    problem = NO_SUCH_NEIGHBOUR;
                    return 0;
                }
                const vf apart = values[other * vectors + v] - own;
                sum += abs(apart);
                if (!counts) continue;
                const vi sign = (apart < 0) - (apart > 0);  // true is -1
                counts[other * vectors + v] += sign;
                own_count -= sign;
            }
            for (int i = 0; i < L; ++i) total += sum[i];
            if (counts) counts[n * vectors + v] += own_count;
        }
    }
    return total;
}

}  // namespace

extern "C" {

// values [N, D], near [N, K]; grad [N, D] may be null. Returns what is wrong (Problem).
int knn_smoothness(int64_t gaussians, int64_t width, int64_t neighbours, int threads,
                   const float *values, const int64_t *near, float *loss, float *grad) {
    const int64_t vectors = (width + L - 1) / L, size = gaussians * vectors;
    const int64_t blocks = (gaussians + BLOCK - 1) / BLOCK;
    const int64_t shared = std::clamp<int64_t>(threads, 1, std::max<int64_t>(blocks, 1));
    const double share = 1.0 / std::max<int64_t>(gaussians * neighbours * width, 1);
    std::vector<vf> padded(size);
    std::vector<vi> counts(grad ? shared * size : 0);
    std::vector<double> sums(blocks);
    for (int64_t n = 0; n < gaussians; ++n)
        std::memcpy(&padded[n * vectors], values + n * width, width * sizeof(float));
    std::atomic<int> problem{NONE};
#pragma omp parallel for num_threads(shared) schedule(static)
    for (int64_t block = 0; block < blocks; ++block)
        sums[block] = differences(block * BLOCK, std::min(gaussians, (block + 1) * BLOCK),
                                  gaussians, vectors, neighbours, padded.data(), near,
                                  grad ? counts.data() + thread() * size : nullptr, problem);
    double total = 0;
    for (const double sum : sums) total += sum;
    *loss = static_cast<float>(total * share);
    for (int64_t n = 0; grad && n < gaussians; ++n) {
        for (int64_t d = 0; d < width; ++d) {
            int32_t count = 0;
            for (int64_t other = 0; other < shared; ++other)
                count += counts[other * size + n * vectors + d / L][d % L];
            grad[n * width + d] = static_cast<float>(share * count);
        }
    }
    return problem;
}
}
