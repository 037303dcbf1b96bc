// Cubic B-splines of poses with their gradients, and how far knots are from other knots.
//
// A pose is J rotations, stored as axis-angle vectors, and a shift. K knots stand at 0, 1, ...; the
// four around a time shape the curve there. With D[k] the turn from knot k to the next,
//   rotation(t) = Q[i - 1] exp(c1 D[i - 1]) exp(c2 D[i]) exp(c3 D[i + 1]),  i = floor(t),
// where c1, c2, c3 are sums of the basis' last three, two, one weights. Outside, the outermost knots
// are repeated, between which nothing turns. Quaternions wxyz; sums and turns are kept in double.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace {

constexpr double SMALL = SMALL_ANGLE * SMALL_ANGLE;  // squared: below it the series is exact

struct V {
    double x, y, z;
};
struct Q {
    double w, x, y, z;
};

inline V operator*(double s, V a) { return {s * a.x, s * a.y, s * a.z}; }
inline V operator+(V a, V b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline void operator+=(V &a, V b) { a = a + b; }
inline double dot(V a, V b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

inline void operator+=(Q &a, Q b) { a = {a.w + b.w, a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Q conj(Q a) { return {a.w, -a.x, -a.y, -a.z}; }
// Of p = a b with gradient g, a has the gradient g conj(b), and b conj(a) g.
inline Q operator*(Q a, Q b) {
    return {a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
            a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
            a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w};
}

inline V load(const float *p) { return {p[0], p[1], p[2]}; }
inline void store(V v, float *p) { p[0] = v.x, p[1] = v.y, p[2] = v.z; }

inline Q exp(V v) {
    const double s = dot(v, v);
    if (s < SMALL) {
        const double f = 0.5 - s / 48;
        return {1 - s / 8, f * v.x, f * v.y, f * v.z};
    }
    const double a = std::sqrt(s), f = std::sin(a / 2) / a;
    return {std::cos(a / 2), f * v.x, f * v.y, f * v.z};
}

// `q` is exp(v).
inline V exp_backward(V v, Q q, Q g) {
    const double s = dot(v, v), along = g.x * v.x + g.y * v.y + g.z * v.z;
    const bool small = s < SMALL;
    const double f = small ? 0.5 - s / 48 : std::sin(std::sqrt(s) / 2) / std::sqrt(s);
    const double real = small ? -0.125 : -f / 4;  // by s, as the next
    const double factor = small ? -1.0 / 48 : (q.w / 2 - f) / (2 * s);
    return f * V{g.x, g.y, g.z} + 2 * (g.w * real + along * factor) * v;
}

// Turns of at most pi.
inline V log(Q q) {
    const double sign = q.w < 0 ? -1 : 1;
    const V v = sign * V{q.x, q.y, q.z};
    const double s = dot(v, v), length = std::sqrt(s);
    return (s < SMALL ? 2 + s / 3 : 2 * std::atan2(length, sign * q.w) / length) * v;
}

inline Q log_backward(Q q, V g) {
    const double sign = q.w < 0 ? -1 : 1, w = sign * q.w;
    const V v = sign * V{q.x, q.y, q.z};
    const double s = dot(v, v), length = std::sqrt(s), along = dot(g, v);
    const bool small = s < SMALL;
    const double factor = small ? 2 + s / 3 : 2 * std::atan2(length, w) / length;
    const double by_real = small ? 0 : -2 / (s + w * w);
    const double by_squared = small ? 1.0 / 3 : (2 * w / (s + w * w) - factor) / (2 * s);
    const V by_v = factor * g + 2 * along * by_squared * v;
    return {sign * along * by_real, sign * by_v.x, sign * by_v.y, sign * by_v.z};
}

// The four knots around a time, and how much each counts, with slopes by time.
struct Piece {
    int64_t knot[4];
    double weight[4], slope[4];  // of each
    double sum[3], sum_slope[3];  // of the last three, two, one

    Piece(double time, int64_t knots) {
        const double last = static_cast<double>(knots - 1), t = std::clamp(time, 0.0, last);
        const int64_t end = std::max<int64_t>(knots - 2, 0);
        const int64_t segment = std::clamp<int64_t>(static_cast<int64_t>(t), 0, end);
        const double u = t - static_cast<double>(segment), v = 1 - u;
        const double inside = time >= 0 && time <= last;
        const double w[4] = {v * v * v, 3 * u * u * u - 6 * u * u + 4,
                             -3 * u * u * u + 3 * u * u + 3 * u + 1, u * u * u};
        const double d[4] = {-3 * v * v, 9 * u * u - 12 * u, -9 * u * u + 6 * u + 3, 3 * u * u};
        for (int64_t i = 0; i < 4; ++i) {
            knot[i] = std::clamp<int64_t>(segment + i - 1, 0, knots - 1);
            weight[i] = w[i] / 6;
            slope[i] = inside * d[i] / 6;
        }
        for (int i = 2; i >= 0; --i) {
            sum[i] = weight[i + 1] + (i < 2 ? sum[i + 1] : 0);
            sum_slope[i] = slope[i + 1] + (i < 2 ? sum_slope[i + 1] : 0);
        }
    }
};

// What all times share: the pieces, rotations of the knots that they need, turns between them.
struct Curve {
    int64_t knots, joints, first, last;
    std::vector<Piece> pieces;
    std::vector<Q> quats;  // [last - first + 1, J]
    std::vector<V> turns;  // [last - first, J]

    Curve(int64_t knots, int64_t joints, int64_t times, const float *axis_angle,
          const float *at)
        : knots(knots), joints(joints), first(knots - 1), last(0) {
        for (int64_t m = 0; m < times; ++m) {
            pieces.emplace_back(at[m], knots);
            first = std::min(first, pieces.back().knot[0]);
            last = std::max(last, pieces.back().knot[3]);
        }
        last = std::max(first, last);
        for (int64_t row = first * joints; row < (last + 1) * joints; ++row)
            quats.push_back(exp(load(axis_angle + 3 * row)));
        for (int64_t row = 0; row < (last - first) * joints; ++row)
            turns.push_back(log(conj(quats[row]) * quats[row + joints]));
    }

    int64_t row(int64_t knot, int64_t joint) const { return (knot - first) * joints + joint; }

    // The part of a turn that a joint has made at a piece; none between a knot and itself.
    V part(const Piece &piece, int step, int64_t joint) const {
        if (piece.knot[step] == piece.knot[step + 1]) return {0, 0, 0};
        return piece.sum[step] * turns[row(piece.knot[step], joint)];
    }
};

}  // namespace

extern "C" {

// axis_angle [K, J, 3], transl [K, 3], at [M]: quats [M, J, 4] and shifts [M, 3].
void pose_spline(int64_t knots, int64_t joints, int64_t times, const float *axis_angle,
                 const float *transl, const float *at, float *quats, float *shifts) {
    const Curve curve(knots, joints, times, axis_angle, at);
    for (int64_t m = 0; m < times; ++m) {
        const Piece &piece = curve.pieces[m];
        for (int64_t j = 0; j < joints; ++j) {
            Q turned = curve.quats[curve.row(piece.knot[0], j)];
            for (int step = 0; step < 3; ++step) turned = turned * exp(curve.part(piece, step, j));
            float *out = quats + 4 * (m * joints + j);
            out[0] = turned.w, out[1] = turned.x, out[2] = turned.y, out[3] = turned.z;
        }
        V shift{};
        for (int i = 0; i < 4; ++i) shift += piece.weight[i] * load(transl + 3 * piece.knot[i]);
        store(shift, shifts + 3 * m);
    }
}

// Gradients of the same; at_grad may be null.
void pose_spline_backward(int64_t knots, int64_t joints, int64_t times, const float *axis_angle,
                          const float *transl, const float *at, const float *quats_grad,
                          const float *shifts_grad, float *axis_angle_grad, float *transl_grad,
                          float *at_grad) {
    const Curve curve(knots, joints, times, axis_angle, at);
    std::vector<Q> by_quat(curve.quats.size());
    std::vector<V> by_turn(curve.turns.size()), by_shift(knots);
    for (int64_t m = 0; m < times; ++m) {
        const Piece &piece = curve.pieces[m];
        double by_time = 0;
        for (int64_t j = 0; j < joints; ++j) {
            const float *given = quats_grad + 4 * (m * joints + j);
            Q grad{given[0], given[1], given[2], given[3]};
            V parts[3];
            Q steps[3], before[3];
            Q turned = curve.quats[curve.row(piece.knot[0], j)];
            for (int step = 0; step < 3; ++step) {
                parts[step] = curve.part(piece, step, j);
                steps[step] = exp(parts[step]);
                before[step] = turned;
                turned = turned * steps[step];
            }
            for (int step = 2; step >= 0; --step) {
                const Q by_step = conj(before[step]) * grad;
                grad = grad * conj(steps[step]);
                if (piece.knot[step] == piece.knot[step + 1]) continue;
                const V by_part = exp_backward(parts[step], steps[step], by_step);
                const int64_t row = curve.row(piece.knot[step], j);
                by_turn[row] += piece.sum[step] * by_part;
                by_time += piece.sum_slope[step] * dot(by_part, curve.turns[row]);
            }
            by_quat[curve.row(piece.knot[0], j)] += grad;
        }
        const V shift = load(shifts_grad + 3 * m);
        for (int i = 0; i < 4; ++i) {
            by_shift[piece.knot[i]] += piece.weight[i] * shift;
            by_time += piece.slope[i] * dot(shift, load(transl + 3 * piece.knot[i]));
        }
        if (at_grad) at_grad[m] = by_time;
    }
    for (size_t row = 0; row < by_turn.size(); ++row) {
        const Q own = curve.quats[row], next = curve.quats[row + joints];
        const Q by_between = log_backward(conj(own) * next, by_turn[row]);
        by_quat[row] += conj(by_between * conj(next));
        by_quat[row + joints] += own * by_between;
    }
    std::fill_n(axis_angle_grad, 3 * knots * joints, 0.0f);
    for (size_t row = 0; row < by_quat.size(); ++row) {
        const int64_t at_row = 3 * (curve.first * joints + row);
        const V grad = exp_backward(load(axis_angle + at_row), curve.quats[row], by_quat[row]);
        store(grad, axis_angle_grad + at_row);
    }
    for (int64_t k = 0; k < knots; ++k) store(by_shift[k], transl_grad + 3 * k);
}

// Mean squared turn of knots [K, J, 3] from others plus the mean squared shift [K, 3] over `lever`.
void knot_distance(int64_t knots, int64_t joints, double lever, const float *axis_angle,
                   const float *transl, const float *other_axis_angle, const float *other_transl,
                   float *distance, float *axis_angle_grad, float *transl_grad) {
    const int64_t rows = knots * joints;
    const double share = 1.0 / std::max<int64_t>(rows, 1);
    double turned = 0, shifted = 0;
    for (int64_t row = 0; row < rows; ++row) {
        const V own = load(axis_angle + 3 * row);
        const Q quat = exp(own), other = exp(load(other_axis_angle + 3 * row));
        const Q between = conj(other) * quat;
        const V turn = log(between);
        turned += dot(turn, turn);
        const Q by_quat = other * log_backward(between, 2 * share * turn);
        store(exp_backward(own, quat, by_quat), axis_angle_grad + 3 * row);
    }
    const double pull = 2 / (lever * lever * std::max<int64_t>(knots, 1));
    for (int64_t k = 0; k < knots; ++k) {
        const V shift = load(transl + 3 * k) + -1.0 * load(other_transl + 3 * k);
        shifted += dot(shift, shift);
        store(pull * shift, transl_grad + 3 * k);
    }
    *distance = turned * share + shifted * pull / 2;
}
}
