// Which triangle of a mesh lies before the middle of each pixel, and where in it: a depth buffer.
//
// Triangles are [T, 3] rows of vertices [P, 3]. `projection` [3, 4] takes the world to pixels times depth, and depth.
// A triangle that reaches nearer than `nearest` is not drawn. Of two that share a point of an edge
// the first is seen.

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace {

constexpr double MIDDLE = 0.5;  // of a pixel
constexpr double EDGE = 1e-9;   // of a triangle's height: what double precision leaves of an edge

struct Point {
    double x, y, depth;
};

inline double area(const Point &a, const Point &b, double x, double y) {
    return (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x);
}

}  // namespace

extern "C" {

// triangle, u, v and depths, which are room to work in: [H, W]. A pixel's point of its triangle abc is
// (1 - u - v) a + u b + v c; where there is no triangle, it is -1. Points: room for [P, 3].
void seen_places(int64_t vertices, int64_t triangles, int64_t width, int64_t height, double nearest,
                 const float *places, const int64_t *corner, const double *projection,
                 double *points, double *depths, int32_t *triangle, float *u, float *v) {
    for (int64_t p = 0; p < vertices; ++p) {
        const float *at = places + 3 * p;
        double row[3];
        for (int k = 0; k < 3; ++k) {
            const double *m = projection + 4 * k;
            row[k] = m[0] * at[0] + m[1] * at[1] + m[2] * at[2] + m[3];
        }
        double *to = points + 3 * p;
        to[0] = row[0] / row[2], to[1] = row[1] / row[2], to[2] = row[2];
    }
    std::fill(triangle, triangle + width * height, -1);
    for (int64_t t = 0; t < triangles; ++t) {
        Point at[3];
        for (int k = 0; k < 3; ++k) {
            const double *from = points + 3 * corner[3 * t + k];
            at[k] = {from[0], from[1], from[2]};
        }
        const auto &[a, b, c] = at;
        if (!(std::min({a.depth, b.depth, c.depth}) > nearest)) continue;
        const double whole = area(a, b, c.x, c.y);
        if (whole == 0) continue;
        const auto first = [](double low) { return std::ceil(low - MIDDLE - EDGE); };
        const auto last = [](double high) { return std::floor(high - MIDDLE + EDGE); };
        const int64_t left = std::max(first(std::min({a.x, b.x, c.x})), 0.0);
        const int64_t right = std::min(last(std::max({a.x, b.x, c.x})), width - 1.0);
        const int64_t top = std::max(first(std::min({a.y, b.y, c.y})), 0.0);
        const int64_t bottom = std::min(last(std::max({a.y, b.y, c.y})), height - 1.0);
        for (int64_t j = top; j <= bottom; ++j) {
            for (int64_t i = left; i <= right; ++i) {
                const double x = i + MIDDLE, y = j + MIDDLE;
                const double in_b = area(c, a, x, y) / whole, in_c = area(a, b, x, y) / whole;
                const double in_a = 1 - in_b - in_c;
                if (std::min({in_a, in_b, in_c}) < -EDGE) continue;
                // Straight in the picture are the inverse depths.
                const double depth = 1 / (in_a / a.depth + in_b / b.depth + in_c / c.depth);
                const int64_t pixel = j * width + i;
                if (triangle[pixel] >= 0 && !(depth < depths[pixel])) continue;
                triangle[pixel] = static_cast<int32_t>(t), depths[pixel] = depth;
                u[pixel] = static_cast<float>(in_b / b.depth * depth);
                v[pixel] = static_cast<float>(in_c / c.depth * depth);
            }
        }
    }
}
}
