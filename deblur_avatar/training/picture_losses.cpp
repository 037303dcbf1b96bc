// How far a render and its coverage are from a frame and its matte, and the gradients of that.
//
// With e = encode(render) (clamped; as sRGB where light is averaged), apart = comparable e - frame,
// in the frame (height H, width W, 3 channels) or, of structure, in the person's box:
//   l1        = mean |apart|
//   structure = mean over both directions and SCALES scales of mean |difference of neighbours' apart|,
//               each scale the means of 2 x 2 (or as many as there are) of the one before
//   mask      = mean |alpha - matte|
// each times its weight; one of weight 0 is not computed. Rows are shared out, and each adds up its
// own sums, which are added in order: results do not depend on the number of threads.
//
// Three walks over the rows: apart, with encode's slope where the gradient will be; the coarser
// scales, there and back; the gradient. Sums are not contracted, and means of pixels are in torch's
// order: where two pictures are the same, their signs are 0 at every scale.
//
// STRUCTURE_SCALES, LINEAR_KNEE, SLOPE, OFFSET and EXPONENT come from losses.py and color.py by way
// of the compiler's command line.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

namespace {

constexpr int64_t C = 3;  // channels
constexpr int SCALES = STRUCTURE_SCALES;
constexpr float KNEE = LINEAR_KNEE, BELOW = SLOPE, SHIFT = OFFSET, GAIN = 1 + OFFSET, ROOT = EXPONENT;

typedef std::unique_ptr<float[]> Floats;

inline Floats floats(int64_t count) { return Floats(new float[count]); }

inline float sign(float x) { return (x > 0 ? 1.0f : 0.0f) - (x < 0 ? 1.0f : 0.0f); }

inline uint32_t bits(float x) {
    uint32_t b;
    std::memcpy(&b, &x, sizeof b);
    return b;
}

inline float from_bits(uint32_t b) {
    float x;
    std::memcpy(&x, &b, sizeof x);
    return x;
}

// x^y of normal x > 0 for small y: log2 by the series of 2 atanh((m - 1) / (m + 1)), exp2 by its
// own around whole numbers; relative error 2e-7.
inline float power(float x, float y) {
    const uint32_t b = bits(x) - 0x3f3504f3u;  // sqrt(1/2): the mantissa m is in [that, sqrt(2))
    const float m = from_bits((b & 0x007fffffu) + 0x3f3504f3u);
    const float s = (m - 1) / (m + 1), s2 = s * s;
    float p = s2 * (2.0f / 9) + 2.0f / 7;
    p = p * s2 + 2.0f / 5;
    p = p * s2 + 2.0f / 3;
    p = p * s2 + 2.0f;
    const float z = y * (static_cast<float>(static_cast<int32_t>(b) >> 23) + 1.44269504f * (p * s));
    const int32_t whole = static_cast<int32_t>(z + 1024.5f) - 1024;  // rounded
    const float t = 0.693147181f * (z - static_cast<float>(whole));
    float q = t * (1.0f / 5040) + 1.0f / 720;
    q = q * t + 1.0f / 120;
    q = q * t + 1.0f / 24;
    q = q * t + 1.0f / 6;
    q = q * t + 1.0f / 2;
    q = q * t + 1.0f;
    q = q * t + 1.0f;
    return from_bits(bits(q) + (static_cast<uint32_t>(whole) << 23));
}

// imaging/exposure.py's `encode` of one row, its comparable part, less the frame; and the slope of
// that. `part` may be null. Returns whether a value is not a number, which clamping would hide.
template <bool LINEAR, bool PART>
bool encode_row(int64_t count, const float *__restrict image, const float *__restrict target,
                const float *__restrict part, float *__restrict apart, float *__restrict slope) {
    uint32_t odd = 0;
#pragma omp simd reduction(| : odd)
    for (int64_t i = 0; i < count; ++i) {
        const float x = image[i];
        odd |= (bits(x) & 0x7fffffffu) > 0x7f800000u;
        const float c = x < 0 ? 0.0f : x > 1 ? 1.0f : x;
        float encoded = c, steep = c == x ? 1.0f : 0.0f;
        if (LINEAR) {
            const float light = c > KNEE ? c : KNEE;
            const float root = GAIN * power(light, 1 / ROOT);
            encoded = c <= KNEE ? c * BELOW : root - SHIFT;
            steep *= c <= KNEE ? BELOW : root / (ROOT * light);
        }
        apart[i] = (PART ? encoded * part[i] : encoded) - target[i];
        slope[i] = PART ? steep * part[i] : steep;
    }
    return odd != 0;
}

// One scale of structure. Values have `stride` floats a row; spread, one row for each of its own,
// is the gradient of its values as that of each value of the next finer scale.
struct Scale {
    int64_t height, width, stride;
    const float *values;
    float across, down;  // weight of one difference along a row, along a column
    Floats own, spread;

    const float *row(int64_t r) const { return values + r * stride; }
};

// Adds to `grad` that of the differences that meet row r; returns the sum of those that start there.
double differences(const Scale &scale, int64_t r, float *__restrict grad) {
    const int64_t last = C * (scale.width - 1);
    const float across = scale.across, down = scale.down;
    const float *here = scale.row(r);
    const float *above = r > 0 ? scale.row(r - 1) : here;
    const float *below = r + 1 < scale.height ? scale.row(r + 1) : here;
    float along_row = 0, along_columns = 0;
#pragma omp simd reduction(+ : along_columns)
    for (int64_t i = 0; i < last + C; ++i) {
        const float before = here[i] - above[i], after = below[i] - here[i];
        along_columns += std::fabs(after);
        grad[i] += down * (sign(before) - sign(after));
    }
    for (int64_t i = 0; i < C; ++i) {
        grad[i] -= across * sign(here[i + C] - here[i]);
        grad[last + i] += across * sign(here[last + i] - here[last + i - C]);
        along_row += std::fabs(here[i + C] - here[i]);
    }
#pragma omp simd reduction(+ : along_row)
    for (int64_t i = C; i < last; ++i) {
        const float before = here[i] - here[i - C], after = here[i + C] - here[i];
        along_row += std::fabs(after);
        grad[i] += across * (sign(before) - sign(after));
    }
    return static_cast<double>(across) * along_row + static_cast<double>(down) * along_columns;
}

// One row of means of 2 x 2 values, in torch's order; fewer at the far edges.
void pool_row(const Scale &fine, int64_t r, float *__restrict out) {
    const bool single = 2 * r + 1 == fine.height;
    const float *one = fine.row(2 * r), *other = single ? one : fine.row(2 * r + 1);
    const float share = single ? 0.5f : 0.25f;
    const float both = single ? 0.0f : 1.0f;
    for (int64_t j = 0; j < fine.width / 2; ++j)
        for (int64_t i = 0; i < C; ++i) {
            const int64_t left = 2 * C * j + i, right = left + C;
            out[C * j + i] = (one[left] + one[right] + both * other[left] + both * other[right]) * share;
        }
    const int64_t last = fine.width / 2;  // alone where widths are odd
    for (int64_t i = C * last; i < C * ((fine.width + 1) / 2); ++i)
        out[i] = (one[i + C * last] + both * other[i + C * last]) * (2 * share);
}

// A row of gradients of means as gradients of the values they are means of.
void spread_row(const Scale &fine, int64_t r, const float *__restrict grad, float *__restrict out) {
    const float share = 2 * r + 1 == fine.height ? 0.5f : 0.25f;
    for (int64_t j = 0; j < fine.width / 2; ++j)
        for (int64_t i = 0; i < C; ++i)
            out[2 * C * j + i] = out[2 * C * j + C + i] = share * grad[C * j + i];
    if (fine.width % 2)
        for (int64_t i = 0; i < C; ++i)
            out[C * (fine.width - 1) + i] = 2 * share * grad[C * (fine.width / 2) + i];
}

void add_spread(const Scale *coarse, int64_t r, int64_t count, float *__restrict grad) {
    if (!coarse) return;
    const float *__restrict from = coarse->spread.get() + r / 2 * count;
#pragma omp simd
    for (int64_t i = 0; i < count; ++i) grad[i] += from[i];
}

// The scales whose differences count: the first sees `apart` where it lies.
std::vector<Scale> scales_of(int64_t height, int64_t width, int64_t stride, const float *apart,
                             double weight) {
    std::vector<Scale> scales;
    for (int k = 0; k < SCALES && std::min(height, width) >= 2; ++k) {
        Scale scale{height, width, stride, apart, 0, 0, nullptr, nullptr};
        const double share = weight / (2 * SCALES * C);
        scale.across = static_cast<float>(share / (height * (width - 1)));
        scale.down = static_cast<float>(share / ((height - 1) * width));
        if (k > 0) {
            scale.own = floats(height * width * C);
            scale.spread = floats(height * scales.back().width * C);
            scale.values = scale.own.get(), scale.stride = C * width;
        }
        scales.push_back(std::move(scale));
        height = (height + 1) / 2, width = (width + 1) / 2;
    }
    return scales;
}

// Fills the coarser scales, and then, coarsest first, their gradients; returns their loss.
double coarser_scales(std::vector<Scale> &scales, int threads) {
    double total = 0;
    for (size_t k = 1; k < scales.size(); ++k) {
#pragma omp parallel for num_threads(threads) schedule(static)
        for (int64_t r = 0; r < scales[k].height; ++r)
            pool_row(scales[k - 1], r, scales[k].own.get() + r * scales[k].stride);
    }
    for (size_t k = scales.size(); k-- > 1;) {
        const Scale &scale = scales[k], &fine = scales[k - 1];
        const Scale *coarse = k + 1 < scales.size() ? &scales[k + 1] : nullptr;
        std::vector<double> sums(scale.height);
#pragma omp parallel for num_threads(threads) schedule(static)
        for (int64_t r = 0; r < scale.height; ++r) {
            std::vector<float> grad(C * scale.width);
            sums[r] = differences(scale, r, grad.data());
            add_spread(coarse, r, C * scale.width, grad.data());
            spread_row(fine, r, grad.data(), scale.spread.get() + r * C * fine.width);
        }
        for (const double sum : sums) total += sum;
    }
    return total;
}

struct Picture {
    int64_t height, width;
    int threads;
    bool linear;
    const float *image, *target, *comparable;
};

struct Box {
    int64_t left, top, right, bottom;
};

// The first walk, within a box.
bool encode(const Picture &picture, const Box &box, float *apart, float *slope) {
    const int64_t wide = box.right - box.left;
    bool odd = false;
#pragma omp parallel for num_threads(picture.threads) schedule(static) reduction(|| : odd)
    for (int64_t r = box.top; r < box.bottom; ++r) {
        const int64_t first = r * picture.width + box.left, at = C * first;
        std::vector<float> part(picture.comparable ? C * wide : 0);
        for (size_t i = 0; i < part.size(); ++i) part[i] = picture.comparable[first + i / C];
        const auto row = picture.linear ? part.empty() ? encode_row<true, false> : encode_row<true, true>
                         : part.empty() ? encode_row<false, false>
                                        : encode_row<false, true>;
        odd = row(C * wide, picture.image + at, picture.target + at, part.data(), apart + at,
                  slope + at) || odd;
    }
    return odd;
}

// l1 and structure with their weights, and the gradient of their sum; whether there is an odd value.
bool picture_and_structure(const Picture &picture, const Box &box, double l1, double structure,
                           float *losses, float *grad) {
    const int64_t height = picture.height, width = picture.width, row = C * width;
    // Where pixels count at all.
    const Box region = l1 != 0 ? Box{0, 0, width, height} : structure != 0 ? box : Box{0, 0, 0, 0};
    if (l1 == 0) std::memset(grad, 0, height * row * sizeof(float));
    const Floats apart = floats(height * row);
    const bool odd = encode(picture, region, apart.get(), grad);
    std::vector<Scale> scales;
    if (structure != 0)
        scales = scales_of(box.bottom - box.top, box.right - box.left, row,
                           &apart[box.top * row + C * box.left], structure);
    const Scale *finest = scales.size() > 0 ? &scales[0] : nullptr;
    const Scale *coarser = scales.size() > 1 ? &scales[1] : nullptr;
    double of_l1 = 0, of_structure = coarser_scales(scales, picture.threads);
    const float share = static_cast<float>(l1 / (height * row));
    std::vector<double> l1_sums(height), structure_sums(height);
#pragma omp parallel for num_threads(picture.threads) schedule(static)
    for (int64_t r = region.top; r < region.bottom; ++r) {
        const float *here = &apart[r * row];
        std::vector<float> buffer(row);
        float *own = buffer.data(), *out = grad + r * row, sum = 0;
        const int64_t first = C * region.left, last = C * region.right;
#pragma omp simd reduction(+ : sum)
        for (int64_t i = first; i < last; ++i) {
            sum += std::fabs(here[i]);
            own[i] = share * sign(here[i]);
        }
        l1_sums[r] = sum;
        if (finest && r >= box.top && r < box.bottom) {
            float *inside = own + C * box.left;
            structure_sums[r] = differences(*finest, r - box.top, inside);
            add_spread(coarser, r - box.top, C * finest->width, inside);
        }
#pragma omp simd
        for (int64_t i = first; i < last; ++i) out[i] *= own[i];
    }
    for (int64_t r = 0; r < height; ++r) of_l1 += l1_sums[r], of_structure += structure_sums[r];
    losses[0] = static_cast<float>(of_l1 * (l1 / (height * row)));
    losses[1] = static_cast<float>(of_structure);
    return odd;
}

// Mean absolute difference of coverage with its weight, and its gradient.
float coverage(int64_t height, int64_t width, int threads, const float *alpha, const float *matte,
               double weight, float *grad) {
    if (weight == 0) {
        std::memset(grad, 0, height * width * sizeof(float));
        return 0;
    }
    const double share = weight / (height * width);
    const float slope = static_cast<float>(share);
    std::vector<double> sums(height);
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t r = 0; r < height; ++r) {
        float sum = 0;
#pragma omp simd reduction(+ : sum)
        for (int64_t i = r * width; i < (r + 1) * width; ++i) {
            const float apart = alpha[i] - matte[i];
            sum += std::fabs(apart);
            grad[i] = slope * sign(apart);
        }
        sums[r] = sum;
    }
    double total = 0;
    for (const double sum : sums) total += sum;
    return static_cast<float>(total * share);
}

}  // namespace

extern "C" {

// image, target: [H, W, 3]; comparable [H, W] may be null; alpha, matte: [H, W]. Box: left, top,
// right, bottom. Weights and losses are those of l1, structure, mask. All outputs are written.
// Returns whether a value of the picture that is looked at is not a number.
int picture_losses(int64_t height, int64_t width, int threads, int linear, const int64_t *box,
                   const double *weights, const float *image, const float *alpha,
                   const float *target, const float *matte, const float *comparable, float *losses,
                   float *image_grad, float *alpha_grad) {
    const Picture picture{height, width, threads, linear != 0, image, target, comparable};
    const bool odd = picture_and_structure(picture, {box[0], box[1], box[2], box[3]}, weights[0],
                                           weights[1], losses, image_grad);
    losses[2] = coverage(height, width, threads, alpha, matte, weights[2], alpha_grad);
    return odd;
}
}
