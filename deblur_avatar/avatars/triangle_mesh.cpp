// What a posed triangle mesh says of itself, and its gradients: the Gaussians on its faces, the
// normals of its vertices, how far it is from even and from smooth.
//
// Vertices are [S, V, 3] at S instants, faces [N, 3] rows of them, all else as in
// mesh_gaussians.py, mesh_normals.py and mesh_terms.py. What has as many rows as faces is found face by face.
// Gradients of a face's corners, [S, N, 3, 3], are then gathered vertex by vertex in the order of its
// corners, so that no result depends on the number of threads. Lists of each row's own, its
// corners or its neighbours, are a row of `starts` and the next: items[starts[v]] up to items[starts[v + 1]].

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace {

constexpr float HALF_SIDE = 0.57735026919f;  // 1 / sqrt(3): of a conjugate half diameter to its side

struct Vec {
    float x, y, z;
};

inline Vec load(const float *at) { return {at[0], at[1], at[2]}; }

inline void store(float *at, Vec a) { at[0] = a.x, at[1] = a.y, at[2] = a.z; }

inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }

inline Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }

inline Vec operator*(float s, Vec a) { return {s * a.x, s * a.y, s * a.z}; }

inline float dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

inline Vec cross(Vec a, Vec b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

struct Corners {
    Vec a, b, c;
};

inline Corners corners(const float *vertices, const int64_t *face) {
    return {load(vertices + 3 * face[0]), load(vertices + 3 * face[1]), load(vertices + 3 * face[2])};
}

// Twice the area, along the normal.
inline Vec across(const Corners &p) { return cross(p.b - p.a, p.c - p.a); }

// The gradient of `across` times a gradient of it, at the corners.
inline void across_backward(const Corners &p, Vec grad, float *corner_grads) {
    const Vec b = cross(p.c - p.a, grad), c = cross(grad, p.b - p.a);
    store(corner_grads, -1.0f * (b + c)), store(corner_grads + 3, b), store(corner_grads + 6, c);
}

// The gradient of v / |v|, given that unit vector; none where it is too short to have a direction.
inline Vec unit_backward(Vec unit, float length, float shortest, Vec grad) {
    if (length <= shortest) return {0, 0, 0};
    return (1 / length) * (grad - dot(unit, grad) * unit);
}

// Axes of the Steiner ellipse and a normal as long as the Gaussian is thick, with what they came of.
struct Frame {
    Vec middle, towards, along;  // the last two: conjugate half diameters
    Vec first, second, normal;   // normal: unit, or nothing of a flat face
    float cosine, sine;          // of the angle from `towards` to `first`
    float twice, longer;         // of that angle doubled: its tangent
    float area;                  // of `first` and `second`; 0 of a flat face
    bool round;
};

inline Frame frame(const Corners &p) {
    Frame f;
    f.middle = (1.0f / 3) * (p.a + p.b + p.c);
    f.towards = p.c - f.middle;
    f.along = HALF_SIDE * (p.b - p.a);
    const float one = dot(f.towards, f.towards), other = dot(f.along, f.along);
    f.twice = 2 * dot(f.towards, f.along);
    f.longer = one - other;
    const float size = ROUND * (one + other), squared = f.twice * f.twice + f.longer * f.longer;
    f.round = squared <= size * size;
    f.cosine = 1, f.sine = 0;
    if (!f.round) {
        // Half the angle, from its double's cosine: whichever of the two is the greater has its digits.
        const float length = std::sqrt(squared), twofold = f.longer / length;
        if (twofold >= 0) {
            f.cosine = std::sqrt((1 + twofold) / 2);
            f.sine = f.twice / length / (2 * f.cosine);
        } else {
            const float sine = std::sqrt((1 - twofold) / 2);
            f.cosine = std::fabs(f.twice) / length / (2 * sine);
            f.sine = std::copysign(sine, f.twice);
        }
    }
    f.first = f.cosine * f.towards + f.sine * f.along;
    f.second = f.cosine * f.along - f.sine * f.towards;
    const Vec normal = cross(f.first, f.second);
    const float area = dot(normal, normal);
    f.area = area <= FLAT * FLAT ? 0 : std::sqrt(area);
    f.normal = f.area == 0 ? Vec{0, 0, 0} : (1 / f.area) * normal;
    return f;
}

// A Gaussian's factor, its frame times its shape, row by row.
struct Factor {
    Vec x, y, z;
};

inline Factor factor(const Frame &f, float thickness, const Vec *shape) {
    const Vec a = f.first, b = f.second, c = thickness * f.normal;
    return {a.x * shape[0] + b.x * shape[1] + c.x * shape[2],
            a.y * shape[0] + b.y * shape[1] + c.y * shape[2],
            a.z * shape[0] + b.z * shape[1] + c.z * shape[2]};
}

// Gradients of the corners, given those of the middle and of the frame's columns.
inline void frame_backward(const Frame &f, float thickness, Vec middle, Vec first, Vec second,
                           Vec normal, float *corner_grads) {
    const Vec area = unit_backward(f.normal, f.area, 0, thickness * normal);
    first = first + cross(f.second, area);
    second = second + cross(area, f.first);
    Vec towards = f.cosine * first - f.sine * second;
    Vec along = f.sine * first + f.cosine * second;
    if (!f.round) {
        const float angle = dot(first, f.second) - dot(second, f.first);
        const float share = angle / 2 / (f.twice * f.twice + f.longer * f.longer);
        const float twice = share * f.longer, longer = -share * f.twice;
        towards = towards + 2 * twice * f.along + 2 * longer * f.towards;
        along = along + 2 * twice * f.towards - 2 * longer * f.along;
    }
    const Vec all = (1.0f / 3) * (middle - towards), side = HALF_SIDE * along;
    store(corner_grads, all - side), store(corner_grads + 3, all + side);
    store(corner_grads + 6, all + towards);
}

// Sums of the gradients of each vertex's corners.
void gather(int64_t instants, int64_t vertices, int64_t faces, int threads, const int32_t *starts,
            const int32_t *items, const float *corner_grads, float *grads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t v = 0; v < vertices; ++v) {
        for (int64_t s = 0; s < instants; ++s) {
            Vec sum{0, 0, 0};
            for (int32_t k = starts[v]; k < starts[v + 1]; ++k)
                sum = sum + load(corner_grads + 3 * (s * 3 * faces + items[k]));
            store(grads + 3 * (s * vertices + v), sum);
        }
    }
}

// Unit normals of faces and their lengths before.
void face_normals(int64_t instants, int64_t vertices, int64_t faces, int threads, float shortest,
                  const float *places, const int64_t *corner, float *normals, float *lengths) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t n = 0; n < faces; ++n) {
        for (int64_t s = 0; s < instants; ++s) {
            const Vec normal = across(corners(places + 3 * s * vertices, corner + 3 * n));
            const int64_t i = s * faces + n;
            lengths[i] = std::sqrt(dot(normal, normal));
            store(normals + 3 * i, (1 / std::max(lengths[i], shortest)) * normal);
        }
    }
}

}  // namespace

extern "C" {

// means [S, N, 3] and covars [S, N, 6], upper triangles, of shapes [N, 3, 3].
void face_gaussians(int64_t instants, int64_t vertices, int64_t faces, int threads, float thickness,
                    const float *places, const int64_t *corner, const float *shapes, float *means,
                    float *covars) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t n = 0; n < faces; ++n) {
        const float *shape = shapes + 9 * n;
        const Vec rows[3] = {load(shape), load(shape + 3), load(shape + 6)};
        for (int64_t s = 0; s < instants; ++s) {
            const Frame f = frame(corners(places + 3 * s * vertices, corner + 3 * n));
            const int64_t i = s * faces + n;
            store(means + 3 * i, f.middle);
            const auto [x, y, z] = factor(f, thickness, rows);
            float *to = covars + 6 * i;
            to[0] = dot(x, x), to[1] = dot(x, y), to[2] = dot(x, z);
            to[3] = dot(y, y), to[4] = dot(y, z), to[5] = dot(z, z);
        }
    }
}

// Gradients of vertices and shapes; starts [V + 1] and items: corners of each vertex.
void face_gaussians_backward(int64_t instants, int64_t vertices, int64_t faces, int threads,
                             float thickness, const float *places, const int64_t *corner,
                             const float *shapes, const float *means_grad,
                             const float *covars_grad, const int32_t *starts, const int32_t *items,
                             float *corner_grads, float *places_grad, float *shapes_grad) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t n = 0; n < faces; ++n) {
        const float *shape = shapes + 9 * n;
        const Vec rows[3] = {load(shape), load(shape + 3), load(shape + 6)};
        Vec shape_grad[3] = {};
        for (int64_t s = 0; s < instants; ++s) {
            const Frame f = frame(corners(places + 3 * s * vertices, corner + 3 * n));
            const int64_t i = s * faces + n;
            const Vec columns[3] = {f.first, f.second, thickness * f.normal};
            const auto [x, y, z] = factor(f, thickness, rows);
            const float *g = covars_grad + 6 * i;
            // Of the factor's rows.
            const Vec gx = 2 * g[0] * x + g[1] * y + g[2] * z;
            const Vec gy = g[1] * x + 2 * g[3] * y + g[4] * z;
            const Vec gz = g[2] * x + g[4] * y + 2 * g[5] * z;
            Vec column_grads[3];
            for (int k = 0; k < 3; ++k) {
                column_grads[k] = {dot(gx, rows[k]), dot(gy, rows[k]), dot(gz, rows[k])};
                const Vec c = columns[k];
                shape_grad[k] = shape_grad[k] + c.x * gx + c.y * gy + c.z * gz;
            }
            frame_backward(f, thickness, load(means_grad + 3 * i), column_grads[0], column_grads[1],
                           column_grads[2], corner_grads + 9 * i);
        }
        if (shapes_grad)
            for (int k = 0; k < 3; ++k) store(shapes_grad + 9 * n + 3 * k, shape_grad[k]);
    }
    gather(instants, vertices, faces, threads, starts, items, corner_grads, places_grad);
}

// Unit normals [S, V, 3] and their lengths before, [S, V]: twice the areas around each vertex.
void vertex_normals(int64_t instants, int64_t vertices, int64_t faces, int threads, float shortest,
                    const float *places, const int64_t *corner, const int32_t *starts,
                    const int32_t *items, float *normals, float *lengths) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t v = 0; v < vertices; ++v) {
        for (int64_t s = 0; s < instants; ++s) {
            Vec sum{0, 0, 0};
            for (int32_t k = starts[v]; k < starts[v + 1]; ++k)
                sum = sum + across(corners(places + 3 * s * vertices, corner + 3 * (items[k] / 3)));
            const int64_t i = s * vertices + v;
            lengths[i] = std::sqrt(dot(sum, sum));
            store(normals + 3 * i, (1 / std::max(lengths[i], shortest)) * sum);
        }
    }
}

void vertex_normals_backward(int64_t instants, int64_t vertices, int64_t faces, int threads,
                             float shortest, const float *places, const int64_t *corner,
                             const int32_t *starts, const int32_t *items, const float *normals,
                             const float *lengths, const float *normals_grad, float *corner_grads,
                             float *places_grad) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t n = 0; n < faces; ++n) {
        const int64_t *face = corner + 3 * n;
        for (int64_t s = 0; s < instants; ++s) {
            Vec grad{0, 0, 0};
            for (int k = 0; k < 3; ++k) {
                const int64_t i = s * vertices + face[k];
                grad = grad + unit_backward(load(normals + 3 * i), lengths[i], shortest,
                                            load(normals_grad + 3 * i));
            }
            across_backward(corners(places + 3 * s * vertices, face), grad,
                            corner_grads + 9 * (s * faces + n));
        }
    }
    gather(instants, vertices, faces, threads, starts, items, corner_grads, places_grad);
}

// Mean 1 - cosine of the angle between faces that are neighbours, and its gradient, which may be null.
// near [N + 1] and neighbours: of each face. Normals [S, N, 3] and lengths [S, N] are room to work in.
void normal_consistency(int64_t instants, int64_t vertices, int64_t faces, int threads,
                        float shortest, const float *places, const int64_t *corner,
                        const int32_t *near, const int32_t *neighbours, const int32_t *starts,
                        const int32_t *items, float *normals, float *lengths, float *corner_grads,
                        float *loss, float *places_grad) {
    face_normals(instants, vertices, faces, threads, shortest, places, corner, normals, lengths);
    const double pairs = std::max(1.0, instants * (near[faces] / 2.0));
    double apart = 0;  // each pair is met from both of its sides
    for (int64_t s = 0; s < instants; ++s) {
        const float *here = normals + 3 * s * faces;
        for (int64_t n = 0; n < faces; ++n)
            for (int32_t k = near[n]; k < near[n + 1]; ++k)
                apart += 1 - dot(load(here + 3 * n), load(here + 3 * neighbours[k]));
    }
    *loss = static_cast<float>(apart / 2 / pairs);
    if (!places_grad) return;
    const float share = static_cast<float>(-1 / pairs);
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t n = 0; n < faces; ++n) {
        for (int64_t s = 0; s < instants; ++s) {
            const float *here = normals + 3 * s * faces;
            Vec grad{0, 0, 0};
            for (int32_t k = near[n]; k < near[n + 1]; ++k)
                grad = grad + load(here + 3 * neighbours[k]);
            const int64_t i = s * faces + n;
            grad = unit_backward(load(normals + 3 * i), lengths[i], shortest, share * grad);
            across_backward(corners(places + 3 * s * vertices, corner + 3 * n), grad,
                            corner_grads + 9 * i);
        }
    }
    gather(instants, vertices, faces, threads, starts, items, corner_grads, places_grad);
}

// Mean squared distance of vertices from the middle of their neighbours, and its gradient, which may be
// null. Pulls [S, V, 3] are room to work in: those middles as seen from the vertices.
void laplacian(int64_t instants, int64_t vertices, int threads, const float *places,
               const int32_t *near, const int32_t *neighbours, float *pulls, float *loss,
               float *places_grad) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t v = 0; v < vertices; ++v) {
        for (int64_t s = 0; s < instants; ++s) {
            const float *here = places + 3 * s * vertices;
            const Vec own = load(here + 3 * v);
            Vec sum{0, 0, 0};
            for (int32_t k = near[v]; k < near[v + 1]; ++k)
                sum = sum + (load(here + 3 * neighbours[k]) - own);
            const int32_t degree = std::max(near[v + 1] - near[v], 1);
            store(pulls + 3 * (s * vertices + v), (1.0f / degree) * sum);
        }
    }
    double total = 0;
    const int64_t count = std::max<int64_t>(instants * vertices, 1);
    for (int64_t i = 0; i < instants * vertices; ++i)
        total += dot(load(pulls + 3 * i), load(pulls + 3 * i));
    *loss = static_cast<float>(total / count);
    if (!places_grad) return;
    const float share = 2.0f / count;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t v = 0; v < vertices; ++v) {
        for (int64_t s = 0; s < instants; ++s) {
            const float *here = pulls + 3 * s * vertices;
            Vec grad = -1.0f * load(here + 3 * v);
            for (int32_t k = near[v]; k < near[v + 1]; ++k) {
                const int32_t other = neighbours[k];
                grad = grad + (1.0f / (near[other + 1] - near[other])) * load(here + 3 * other);
            }
            store(places_grad + 3 * (s * vertices + v), share * grad);
        }
    }
}
}
