// How far a render and its coverage are from a frame and its matte, and the gradients of that: what
// picture_losses.cpp says, one value of the picture at a time.
//
// Values of the picture that are not numbers make the losses that see them not numbers.
//
// STRUCTURE_SCALES, LINEAR_KNEE, SLOPE, OFFSET and EXPONENT come from losses.py and color.py by way
// of the compiler's command line.

#include <cmath>

#include "../rendering/each.h"

namespace {

constexpr int64_t C = 3;  // channels
constexpr int SCALES = STRUCTURE_SCALES;
constexpr float KNEE = LINEAR_KNEE, BELOW = SLOPE, SHIFT = OFFSET, GAIN = 1 + OFFSET, ROOT = EXPONENT;

FORMULA float sign(float x) { return (x > 0 ? 1.0f : 0.0f) - (x < 0 ? 1.0f : 0.0f); }

// One scale of structure: values with `stride` floats a row, and their gradient, which for the
// finest is written with the picture's.
struct Scale {
    int64_t height, width, stride;
    const float *values;
    float *grad;
    float across, down;  // weight of one difference along a row, along a column

    FORMULA float at(int64_t row, int64_t column, int64_t c) const {
        return values[row * stride + C * column + c];
    }

    // The gradient of the differences that meet a value; `sum` gains those that start there.
    FORMULA float differences(int64_t row, int64_t column, int64_t c, double *sum) const {
        const float here = at(row, column, c);
        float found = 0;
        if (row > 0) found += down * sign(here - at(row - 1, column, c));
        if (row + 1 < height) {
            const float after = at(row + 1, column, c) - here;
            found -= down * sign(after);
            *sum += static_cast<double>(down) * fabsf(after);
        }
        if (column > 0) found += across * sign(here - at(row, column - 1, c));
        if (column + 1 < width) {
            const float after = at(row, column + 1, c) - here;
            found -= across * sign(after);
            *sum += static_cast<double>(across) * fabsf(after);
        }
        return found;
    }

    // How many values a mean of the next coarser scale is of.
    FORMULA int pooled(int64_t row, int64_t column) const {
        return (2 * row + 1 < height ? 2 : 1) * (2 * column + 1 < width ? 2 : 1);
    }

    FORMULA float mean(int64_t row, int64_t column, int64_t c) const {
        const bool below = 2 * row + 1 < height, right = 2 * column + 1 < width;
        float sum = at(2 * row, 2 * column, c);
        if (right) sum += at(2 * row, 2 * column + 1, c);
        if (below) sum += at(2 * row + 1, 2 * column, c);
        if (below && right) sum += at(2 * row + 1, 2 * column + 1, c);
        return sum / pooled(row, column);
    }

    // What a value gains from the gradient of the mean that it is part of.
    FORMULA float spread(const Scale &coarse, int64_t row, int64_t column, int64_t c) const {
        const int64_t above = row / 2, left = column / 2;
        return coarse.grad[(above * coarse.width + left) * C + c] / pooled(above, left);
    }
};

struct Scales {
    Scale of[SCALES];
    int count = 0;
};

// Those whose differences count; scratch memory is taken for all but the finest.
Scales scales_of(int64_t height, int64_t width, int64_t stride, const float *apart, double weight,
                 float *scratch) {
    Scales scales;
    while (scales.count < SCALES && height >= 2 && width >= 2) {
        const double share = weight / (2 * SCALES * C);
        Scale scale{height, width, stride, apart, nullptr,
                    static_cast<float>(share / (height * (width - 1))),
                    static_cast<float>(share / ((height - 1) * width))};
        if (scales.count > 0) {
            scale.stride = C * width;
            scale.values = scratch, scale.grad = scratch + C * height * width;
            scratch += 2 * C * height * width;
        }
        scales.of[scales.count++] = scale;
        height = (height + 1) / 2, width = (width + 1) / 2;
    }
    return scales;
}

// imaging/exposure.py's `encode` of one value, and its slope.
FORMULA float encoded(float x, bool linear, float *slope) {
    const float c = x < 0 ? 0.0f : x > 1 ? 1.0f : x;
    *slope = c == x ? 1.0f : 0.0f;
    if (!linear) return c;
    const float light = c > KNEE ? c : KNEE;
    const float root = GAIN * powf(light, 1 / ROOT);
    *slope *= c <= KNEE ? BELOW : root / (ROOT * light);
    return c <= KNEE ? c * BELOW : root - SHIFT;
}

}  // namespace

extern "C" {

// image, target: [H, W, 3]; comparable [H, W] may be null; alpha, matte: [H, W]. Weights, which are
// the host's, and losses are those of l1, structure, mask; the picture's gradients, [2, H, W, 3], are
// those of the first two. sums: three zeros; scratch: [3, H, W, 3], which is more than all scales
// take. All other outputs are written.
void picture_losses(int64_t height, int64_t width, int64_t linear, int64_t left, int64_t top,
                    int64_t right, int64_t bottom, Place place, const double *weights,
                    const float *image, const float *alpha, const float *target,
                    const float *matte, const float *comparable, double *sums, float *scratch,
                    float *losses, float *image_grads, float *alpha_grad) {
    const int64_t pixels = height * width, size = C * pixels;
    const double l1 = weights[0], structure = weights[1], mask = weights[2];
    float *apart = scratch, *of_l1 = image_grads, *of_structure = image_grads + size;
    // The slope of each value, where pixels count at all; gradients are it times what follows.
    each(size, place, DO(int64_t i) {
        const int64_t pixel = i / C, row = pixel / width, column = pixel % width;
        const bool inside = row >= top && row < bottom && column >= left && column < right;
        float slope = 0, value = 0;
        if (l1 != 0 || (structure != 0 && inside)) {
            const float part = comparable ? comparable[pixel] : 1.0f;
            value = std::isnan(image[i]) ? NAN : part * encoded(image[i], linear, &slope) - target[i];
            slope *= part;
        }
        apart[i] = value, of_l1[i] = slope;
    });
    Scales scales;
    if (structure != 0)
        scales = scales_of(bottom - top, right - left, C * width, apart + C * (top * width + left),
                           structure, scratch + size);
    for (int k = 1; k < scales.count; ++k) {
        const Scale scale = scales.of[k], fine = scales.of[k - 1];
        float *means = const_cast<float *>(scale.values);
        each(C * scale.height * scale.width, place, DO(int64_t i) {
            means[i] = fine.mean(i / scale.stride, i % scale.stride / C, i % C);
        });
    }
    for (int k = scales.count; k-- > 1;) {
        const bool coarsest = k + 1 == scales.count;
        const Scale scale = scales.of[k], coarse = scales.of[coarsest ? k : k + 1];
        each_sum<1>(C * scale.height * scale.width, place, sums + 1, DO(int64_t i, double *sum) {
            const int64_t row = i / scale.stride, column = i % scale.stride / C, c = i % C;
            float grad = scale.differences(row, column, c, sum);
            if (!coarsest) grad += scale.spread(coarse, row, column, c);
            scale.grad[i] = grad;
        });
    }
    const Scale finest = scales.of[0], coarse = scales.of[1];
    const int count = scales.count;
    const float share = static_cast<float>(l1 / size);
    each_sum<2>(size, place, sums, DO(int64_t i, double *sum) {
        const int64_t pixel = i / C, c = i % C, row = pixel / width, column = pixel % width;
        const bool inside = row >= top && row < bottom && column >= left && column < right;
        const float slope = of_l1[i];
        sum[0] += fabsf(apart[i]);
        of_l1[i] = slope * (share * sign(apart[i]));
        float grad = 0;
        if (count > 0 && inside) {
            grad = finest.differences(row - top, column - left, c, sum + 1);
            if (count > 1) grad += finest.spread(coarse, row - top, column - left, c);
        }
        of_structure[i] = slope * grad;
    });
    const float slope = static_cast<float>(mask / pixels);
    each_sum<1>(pixels, place, sums + 2, DO(int64_t i, double *sum) {
        const float apart = mask != 0 ? alpha[i] - matte[i] : 0.0f;
        sum[0] += fabsf(apart);
        alpha_grad[i] = slope * sign(apart);
    });
    each(1, place, DO(int64_t) {
        losses[0] = l1 != 0 ? static_cast<float>(sums[0] * (l1 / size)) : 0.0f;
        losses[1] = static_cast<float>(sums[1]);
        losses[2] = static_cast<float>(sums[2] * (mask / pixels));
    });
}
}
