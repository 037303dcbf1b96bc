// A differentiable Gaussian rasterizer for CPUs, one lane a pixel or one lane a Gaussian.
//
// Three calls make a picture and its gradient. All memory belongs to the caller (cpu.py).
//
//   project    one lane a Gaussian. Project to the image, write one 64-byte record each, count how
//              many Gaussians meet each tile.
//   forward    Hand the Gaussians to the tiles; then, tile by tile: sort by depth, find which
//              blocks each Gaussian reaches, and composite block by block, one lane a pixel.
//   backward   Composite again in the same order, now with the gradient of the picture at hand;
//              sum each Gaussian's share over pixels; then, one lane a Gaussian, carry the sums
//              back through the projection.
//
// Words. A block is as many pixels as a vector has lanes (L); its compositing state stays in
// registers. A tile is BLOCKS blocks. A pair is one Gaussian meeting one tile. A visit is one
// Gaussian meeting one block; whether there is a visit is one bit per pair and block, found exactly
// (the ellipse alpha >= MIN_ALPHA against the block's rectangle). A slot holds what one pair
// contributes to the gradient: every pair writes its own, each Gaussian then adds up its own in a
// fixed order. So there are no atomics, and results do not depend on the number of threads.
//
// The exponent is in base 2: alpha = exp2(logo + (a dx + b dy) dx + c dy^2), x to the right.
//
// The constants NEAR_PLANE, VIEW_MARGIN, MAX_ALPHA, MIN_ALPHA and MIN_TRANSMITTANCE come
// from conventions.py by way of the compiler's command line.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

#ifdef _OPENMP
#include <omp.h>
#endif

namespace {

// ---------------------------------------------------------------- vectors as wide as the machine's

#if defined(__AVX512F__)
constexpr int L = 16, GRID_W = 4, GRID_H = 4;
#elif defined(__AVX__)
constexpr int L = 8, GRID_W = 4, GRID_H = 8;
#else
constexpr int L = 4, GRID_W = 4, GRID_H = 8;
#endif
constexpr int ROWS = L / 4, BLOCK_W = 4, BLOCK_H = ROWS;
constexpr int BLOCKS = GRID_W * GRID_H, TILE_W = GRID_W * BLOCK_W, TILE_H = GRID_H * BLOCK_H;
static_assert(BLOCKS % L == 0, "visits are found one lane a block");

typedef float vf __attribute__((vector_size(L * 4)));
typedef int32_t vi __attribute__((vector_size(L * 4)));

inline vf splat(float x) { return x - vf{}; }
inline vi splat(int32_t x) { return x - vi{}; }
inline vf min(vf a, vf b) { return a < b ? a : b; }
inline vf max(vf a, vf b) { return a > b ? a : b; }
inline vf clamp(vf x, vf low, vf high) { return max(low, min(x, high)); }
inline vf abs(vf x) { return (vf)((vi)x & 0x7fffffff); }
inline vf to_float(vi x) { return __builtin_convertvector(x, vf); }
inline vi to_int(vf x) { return __builtin_convertvector(x, vi); }
inline vf only(vi mask, vf x) { return (vf)((vi)x & mask); }

inline vf load(const float* p) {
  vf v;
  std::memcpy(&v, p, sizeof v);
  return v;
}
inline void store(float* p, vf v) { std::memcpy(p, &v, sizeof v); }

inline vf sqrt(vf x) {
  for (int i = 0; i < L; ++i) x[i] = __builtin_sqrtf(x[i]);
  return x;
}

// Rounding through integers: exact, and no flag that relaxes arithmetic can undo it.
inline vf floor(vf x) {
  const vf n = to_float(to_int(x));
  return n > x ? n - 1.0f : n;
}
inline vf ceil(vf x) {
  const vf n = to_float(to_int(x));
  return n < x ? n + 1.0f : n;
}

inline bool any(vi mask) {
  constexpr int words = sizeof(vi) / 8;
  uint64_t w[words], all = 0;
  std::memcpy(w, &mask, sizeof mask);
  for (int i = 0; i < words; ++i) all |= w[i];
  return all != 0;
}

// Not NaN and not infinite, told from the bits: comparisons may be compiled as if neither existed.
inline vi finite(vf x) { return ((vi)x & 0x7f800000) != 0x7f800000; }

inline vi lane_numbers() {
  vi v;
  for (int i = 0; i < L; ++i) v[i] = i;
  return v;
}

// log2 of positive, normal x, by the series of 2 atanh((m - 1) / (m + 1)); relative error 3e-8.
inline vf log2(vf x) {
  const vi bits = (vi)x - 0x3f3504f3;  // sqrt(1/2): the mantissa m lies in [sqrt(1/2), sqrt(2))
  const vf exponent = to_float(bits >> 23);
  const vf m = (vf)((bits & 0x007fffff) + 0x3f3504f3);
  const vf s = (m - 1.0f) / (m + 1.0f), s2 = s * s;
  vf y = s2 * (2.0f / 9.0f) + 2.0f / 7.0f;
  y = y * s2 + 2.0f / 5.0f;
  y = y * s2 + 2.0f / 3.0f;
  y = y * s2 + 2.0f;
  return exponent + 1.44269504f * (y * s);
}

// Permutations of two vectors, written as a function from a lane to where it comes from: lanes of
// `a` are counted from 0, those of `b` from L.
#if defined(__clang__)
template <class Where>
inline vf permute(vf a, vf b, Where where) {
  vf out;
  for (int i = 0; i < L; ++i) out[i] = where(i) < L ? a[where(i)] : b[where(i) - L];
  return out;
}
#else
template <class Where>
inline vf permute(vf a, vf b, Where where) {
  vi from;
  for (int i = 0; i < L; ++i) from[i] = where(i);
  return __builtin_shuffle(a, b, from);
}
#endif

// A vector is ROWS rows of four lanes. Within each row, of a and b in turn: the first two lanes of
// both alternating, the last two alternating, the first two, the last two.
inline vf interleave_first(vf a, vf b) {
  return permute(a, b, [](int i) { return (i & ~3) + (i >> 1 & 1) + (i & 1 ? L : 0); });
}
inline vf interleave_last(vf a, vf b) {
  return permute(a, b, [](int i) { return (i & ~3) + 2 + (i >> 1 & 1) + (i & 1 ? L : 0); });
}
inline vf join_first(vf a, vf b) {
  return permute(a, b, [](int i) { return (i & ~3) + (i & 1) + (i & 2 ? L : 0); });
}
inline vf join_last(vf a, vf b) {
  return permute(a, b, [](int i) { return (i & ~3) + 2 + (i & 1) + (i & 2 ? L : 0); });
}
template <int lane>
inline vf splat_in_rows(vf a) {
  return permute(a, a, [](int i) { return (i & ~3) + lane; });
}
// Of the rows of a, then those of b: every second one, from the first or from the second on.
inline vf even_rows(vf a, vf b) {
  return permute(a, b, [](int i) { return 8 * (i >> 2) + (i & 3); });
}
inline vf odd_rows(vf a, vf b) {
  return permute(a, b, [](int i) { return 8 * (i >> 2) + 4 + (i & 3); });
}

// Transpose the 4 x 4 matrices that row after row of four vectors make.
inline void transpose_in_rows(const vf* in, vf* out) {
  const vf a = interleave_first(in[0], in[1]), b = interleave_first(in[2], in[3]);
  const vf c = interleave_last(in[0], in[1]), d = interleave_last(in[2], in[3]);
  out[0] = join_first(a, b), out[1] = join_last(a, b);
  out[2] = join_first(c, d), out[3] = join_last(c, d);
}

// Transpose the matrix whose entries are the rows of ROWS vectors, `stride` apart.
inline void transpose_rows(vf* v, int stride) {
  if (ROWS == 2) {
    const vf a = v[0], b = v[stride];
    v[0] = even_rows(a, b), v[stride] = odd_rows(a, b);
  } else if (ROWS == 4) {
    const vf a = v[0], b = v[stride], c = v[2 * stride], d = v[3 * stride];
    const vf even = even_rows(a, b), odd = odd_rows(a, b);
    const vf even2 = even_rows(c, d), odd2 = odd_rows(c, d);
    v[0] = even_rows(even, even2), v[2 * stride] = odd_rows(even, even2);
    v[stride] = even_rows(odd, odd2), v[3 * stride] = odd_rows(odd, odd2);
  }
}

// Row i of the result is the sum of the rows of v[i].
inline vf sum_of_rows(const vf* v) {
  if (ROWS == 1) return v[0];
  const vf first = even_rows(v[0], v[1 % ROWS]) + odd_rows(v[0], v[1 % ROWS]);
  if (ROWS == 2) return first;
  const vf second = even_rows(v[2 % ROWS], v[3 % ROWS]) + odd_rows(v[2 % ROWS], v[3 % ROWS]);
  return even_rows(first, second) + odd_rows(first, second);
}

// Transpose L vectors.
inline void transpose(vf* v) {
  for (int i = 0; i < L; i += 4) transpose_in_rows(v + i, v + i);
  for (int i = 0; i < 4; ++i) transpose_rows(v + i, 4);
}

// Several vectors treated alike: their instructions alternate, so that none waits for the last.
constexpr int M = 4;
struct Many {
  vf v[M];
  vf& operator[](int i) { return v[i]; }
  const vf& operator[](int i) const { return v[i]; }
};
template <class F>
inline Many each(F f) {
  Many out;
  for (int i = 0; i < M; ++i) out[i] = f(i);
  return out;
}
inline Many operator+(const Many& a, const Many& b) {
  return each([&](int i) { return a[i] + b[i]; });
}
inline Many operator*(const Many& a, const Many& b) {
  return each([&](int i) { return a[i] * b[i]; });
}

// 2^p for p in [-126, 127], anything for others. Degree 5, minimax on [-1, 0] among those that are
// 1 at 0: relative error 8.4e-8.
inline Many exp2(const Many& p) {
  vi n[M];
  for (int i = 0; i < M; ++i) n[i] = to_int(p[i]);  // towards zero
  const Many f = each([&](int i) { return p[i] - to_float(n[i]); });
  Many y = each([&](int i) { return 9.44903476e-4f * f[i] + 9.20579777e-3f; });
  y = each([&](int i) { return y[i] * f[i] + 5.52973579e-2f; });
  y = each([&](int i) { return y[i] * f[i] + 2.40180143e-1f; });
  y = each([&](int i) { return y[i] * f[i] + 6.93143721e-1f; });
  y = each([&](int i) { return y[i] * f[i] + 1.0f; });
  return each([&](int i) { return (vf)((vi)y[i] + (n[i] << 23)); });
}

// ------------------------------------------------------------------------------- data and layouts

constexpr float LOG2E = 1.44269504f;
constexpr float LN2 = 0.69314718f;
const float LOG2_MIN_ALPHA = std::log2(MIN_ALPHA);
constexpr int MAX_VALUES = 5;  // four channels and depth

// One Gaussian of one pose in the image.
struct alignas(64) Record {
  float x, y;                // centre, pixels
  float a, b, c;             // exponent, base 2
  float logo;                // log2 of the opacity
  float steer_y, steer_x;    // where the exponent is largest along a line: dy = steer_y dx, ...
  float value[MAX_VALUES];   // channels, then depth
  int32_t slot;              // its first slot, counted from that of its chunk
  int16_t tile_x, tile_y;    // first tile it meets
  int32_t tile_columns;
};
static_assert(sizeof(Record) == 64, "one cache line");

// What the stages between need of it.
struct Placement {
  uint32_t key;  // depth, as bits: positive floats are ordered like integers
  int16_t x0, y0, x1, y1;  // tiles it meets, ends excluded
  int32_t slot;
};
static_assert(sizeof(Placement) == 16, "four to a cache line");

constexpr int SEGMENT = 512;      // pairs whose records are copied together: stays in L1 and L2
constexpr int GROUP = 64;         // pairs whose visits make one word per block

struct Visits {
  int32_t half[2][BLOCKS];  // bit j of half h: pair 32 h + j of the group visits the block
  uint64_t word(int block) const {
    return (uint32_t)half[0][block] | (uint64_t)(uint32_t)half[1][block] << 32;
  }
};

}  // namespace

extern "C" {

// Everything the three calls share; cpu.py fills it and mirrors this layout.
struct Frame {
  int64_t poses, gaussians, channels, width, height;
  int64_t covar_columns;  // 6 or 9
  int64_t covars_shared;  // one set for all poses
  int64_t average, depth, keep, threads;
  int64_t chunks, chunk_shift;  // a pose is cut into chunks of 2^chunk_shift Gaussians
  int64_t tiles_x, tiles_y;
  int64_t pairs, busy;  // found by `project`: pairs, and (pose, tile)s that have any
  int64_t largest;      // found by `project`: the most pairs of one pose
  int64_t slot_capacity;
  double eps2d;  // low-pass, px^2
  // inputs
  const float *means, *covars, *opacities, *colors, *viewmat, *K, *background;
  // made by `project`
  Record* records;          // [poses, gaussians]
  Placement* placements;    // [poses, gaussians]
  int32_t* radii;           // [poses, gaussians]
  int32_t* histogram;       // [poses, chunks, tiles]: pairs of each chunk, then where they go
  int32_t* tile_start;      // [poses, tiles + 1]
  int32_t* chunk_slot;      // [poses, chunks + 1]: first slot of each chunk
  int32_t* busy_index;      // [poses, tiles]: which busy tile this is, or -1
  int32_t* busy_start;      // [poses + 1]: first busy tile of each pose
  // made by `forward`
  uint64_t* unsorted;       // [2, pairs]: depth and number; scratch
  int32_t* sorted;          // [pairs]: numbers, front to back within each tile
  int32_t* busy_tiles;      // [busy]: pose * tiles + tile
  int32_t* composited;      // [busy]: pairs looked at before every pixel was finished
  Visits* visits;           // [pairs / GROUP + busy]
  float* states;            // [busy, BLOCKS, values + 1, L]: what was seen, and what shines through
  float *image, *alpha, *depths;
  // gradients in and out; null where not given or not wanted
  const float *image_grad, *alpha_grad, *depths_grad;
  float* slots;             // [slot_capacity, SLOT]
  float *means_grad, *covars_grad, *opacities_grad, *colors_grad, *background_grad;
  float *means2d_grad, *means2d_absgrad;
};

}  // extern "C"

namespace {

int64_t tiles_of(const Frame& f) { return f.tiles_x * f.tiles_y; }
int64_t values_of(const Frame& f) { return f.channels + f.depth; }

// The camera, broadcast once per call.
struct Camera {
  float r[3][3], t[3], fx, fy, cx, cy, low_x, high_x, low_y, high_y, eps2d;

  explicit Camera(const Frame& f) {
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) r[i][j] = f.viewmat[4 * i + j];
      t[i] = f.viewmat[4 * i + 3];
    }
    fx = f.K[0], cx = f.K[2], fy = f.K[4], cy = f.K[5], eps2d = (float)f.eps2d;
    const float margin_x = VIEW_MARGIN * 0.5f * f.width / fx;
    const float margin_y = VIEW_MARGIN * 0.5f * f.height / fy;
    low_x = -cx / fx - margin_x, high_x = (f.width - cx) / fx + margin_x;
    low_y = -cy / fy - margin_y, high_y = (f.height - cy) / fy + margin_y;
  }
};

// Read `columns` floats of each of L rows, one lane a row; rows past the end repeat the last.
template <int columns>
inline void load_rows(const float* from, int64_t rows, vf* to) {
  alignas(64) float t[columns][L];
  if (rows >= L) {
    for (int k = 0; k < L; ++k)
      for (int c = 0; c < columns; ++c) t[c][k] = from[k * columns + c];
  } else {
    for (int k = 0; k < L; ++k) {
      const float* const row = from + std::min<int64_t>(k, rows - 1) * columns;
      for (int c = 0; c < columns; ++c) t[c][k] = row[c];
    }
  }
  for (int c = 0; c < columns; ++c) to[c] = load(t[c]);
}

template <int columns>
inline void store_rows(float* to, int64_t rows, const vf* from) {
  alignas(64) float t[columns][L];
  for (int c = 0; c < columns; ++c) store(t[c], from[c]);
  if (rows >= L) {
    for (int k = 0; k < L; ++k)
      for (int c = 0; c < columns; ++c) to[k * columns + c] = t[c][k];
  } else {
    for (int k = 0; k < rows; ++k)
      for (int c = 0; c < columns; ++c) to[k * columns + c] = t[c][k];
  }
}

__attribute__((noinline)) void load_covars(const Frame& f, int64_t pose, int64_t i, int64_t rows,
                                           vf* s) {
  const float* from = f.covars + ((f.covars_shared ? 0 : pose * f.gaussians) + i) * f.covar_columns;
  if (f.covar_columns == 6) return load_rows<6>(from, rows, s);
  vf whole[9];
  load_rows<9>(from, rows, whole);
  s[0] = whole[0], s[1] = whole[1], s[2] = whole[2];
  s[3] = whole[4], s[4] = whole[5], s[5] = whole[8];
}

// L Gaussians projected; the same code serves both directions.
struct Projection {
  vf z, rz, slope_x, slope_y;      // of the centre, in the camera
  vf clamped_x, clamped_y;         // slopes at which the Jacobian is taken
  vf x, y;                         // pixels
  vf m0[3], m1[3];                 // rows of the Jacobian, from world space
  vf s0[3], s1[3];                 // covariance times those
  vf xx, xy, yy;                   // covariance, px^2
  vf conic_xx, conic_xy, conic_yy;
  vi solid;                        // in front of the camera, not degenerate

  Projection(const Camera& cam, const vf* mean, const vf* s) {
    const vf px = cam.r[0][0] * mean[0] + cam.r[0][1] * mean[1] + cam.r[0][2] * mean[2] + cam.t[0];
    const vf py = cam.r[1][0] * mean[0] + cam.r[1][1] * mean[1] + cam.r[1][2] * mean[2] + cam.t[1];
    z = cam.r[2][0] * mean[0] + cam.r[2][1] * mean[1] + cam.r[2][2] * mean[2] + cam.t[2];
    solid = z >= NEAR_PLANE;
    rz = 1.0f / (solid ? z : splat(1.0f));
    slope_x = px * rz, slope_y = py * rz;
    clamped_x = clamp(slope_x, splat(cam.low_x), splat(cam.high_x));
    clamped_y = clamp(slope_y, splat(cam.low_y), splat(cam.high_y));
    x = cam.fx * slope_x + cam.cx, y = cam.fy * slope_y + cam.cy;
    const vf scale_x = cam.fx * rz, scale_y = cam.fy * rz;
    for (int i = 0; i < 3; ++i) {
      m0[i] = scale_x * (cam.r[0][i] - clamped_x * cam.r[2][i]);
      m1[i] = scale_y * (cam.r[1][i] - clamped_y * cam.r[2][i]);
    }
    times(s, m0, s0);
    times(s, m1, s1);
    xx = m0[0] * s0[0] + m0[1] * s0[1] + m0[2] * s0[2] + cam.eps2d;
    xy = m0[0] * s1[0] + m0[1] * s1[1] + m0[2] * s1[2];
    yy = m1[0] * s1[0] + m1[1] * s1[1] + m1[2] * s1[2] + cam.eps2d;
    const vf determinant = xx * yy - xy * xy;
    solid &= determinant > 0.0f;
    const vf inverse = 1.0f / (solid ? determinant : splat(1.0f));
    conic_xx = yy * inverse, conic_xy = -xy * inverse, conic_yy = xx * inverse;
    solid &= finite(x) & finite(y) & finite(xx) & finite(yy) & finite(conic_xx) &
             finite(conic_xy) & finite(conic_yy);
  }

  static void times(const vf* s, const vf* m, vf* out) {
    out[0] = s[0] * m[0] + s[1] * m[1] + s[2] * m[2];
    out[1] = s[1] * m[0] + s[3] * m[1] + s[4] * m[2];
    out[2] = s[2] * m[0] + s[4] * m[1] + s[5] * m[2];
  }
};

enum NotFinite { MEANS = 1, COVARS = 2, OPACITIES = 4, COLORS = 8, TOO_MANY_PAIRS = 16 };

// Project one chunk of one pose and count its pairs; returns which inputs were not finite.
int project_chunk(const Frame& f, const Camera& cam, int64_t pose, int64_t begin, int64_t end,
                  int32_t* histogram, int64_t& pairs) {
  const int64_t N = f.gaussians, C = f.channels;
  const vi lane = lane_numbers();
  vi bad_mean = {}, bad_covar = {}, bad_opacity = {}, bad_color = {};
  pairs = 0;
  for (int64_t i = begin; i < end; i += L) {
    const int64_t rows = end - i;
    vf mean[3], s[6], opacity[1];
    load_rows<3>(f.means + (pose * N + i) * 3, rows, mean);
    load_covars(f, pose, i, rows, s);
    load_rows<1>(f.opacities + i, rows, opacity);
    for (int k = 0; k < 3; ++k) bad_mean |= ~finite(mean[k]);
    for (int k = 0; k < 6; ++k) bad_covar |= ~finite(s[k]);
    bad_opacity |= ~finite(opacity[0]);
    const Projection p(cam, mean, s);

    vi visible = p.solid & (opacity[0] >= MIN_ALPHA) & (lane < (int32_t)std::min<int64_t>(rows, L));
    const vf logo = log2(max(opacity[0], splat(MIN_ALPHA)));
    const vf reach = 2.0f * LN2 * max(logo - LOG2_MIN_ALPHA, splat(0.0f));
    const vf most = splat(1e9f);
    const vf extent_x = min(sqrt(max(reach * p.xx, splat(0.0f))), most);
    const vf extent_y = min(sqrt(max(reach * p.yy, splat(0.0f))), most);
    const vf rounded_x = ceil(extent_x), rounded_y = ceil(extent_y);
    const vf width = splat((float)f.width), height = splat((float)f.height);
    visible &= (p.x + rounded_x > 0.0f) & (p.x - rounded_x < width);
    visible &= (p.y + rounded_y > 0.0f) & (p.y - rounded_y < height);
    visible &= (rounded_x > 0.0f) | (rounded_y > 0.0f);

    // Pixels whose centres the box holds; the slack covers rounding, blocks are tested exactly.
    const vf slack_x = 1e-3f + 1e-5f * extent_x, slack_y = 1e-3f + 1e-5f * extent_y;
    const vf zero = splat(0.0f);
    const vf first_x = ceil(clamp(p.x - extent_x - slack_x - 0.5f, zero, width));
    const vf first_y = ceil(clamp(p.y - extent_y - slack_y - 0.5f, zero, height));
    const vf last_x = floor(clamp(p.x + extent_x + slack_x - 0.5f, splat(-1.0f), width - 1.0f));
    const vf last_y = floor(clamp(p.y + extent_y + slack_y - 0.5f, splat(-1.0f), height - 1.0f));
    const vi meets = visible & (first_x <= last_x) & (first_y <= last_y);
    const vi x0 = to_int(first_x) / TILE_W & meets, x1 = (to_int(last_x) / TILE_W + 1) & meets;
    const vi y0 = to_int(first_y) / TILE_H & meets, y1 = (to_int(last_y) / TILE_H + 1) & meets;
    const vi radius = to_int(max(rounded_x, rounded_y)) & visible;

    vf column[16] = {p.x,
                     p.y,
                     -0.5f * LOG2E * p.conic_xx,
                     -LOG2E * p.conic_xy,
                     -0.5f * LOG2E * p.conic_yy,
                     logo,
                     -p.conic_xy / p.conic_yy,
                     -p.conic_xy / p.conic_xx};
    for (int64_t c = 0; c < C; ++c) {
      alignas(64) float t[L];
      for (int k = 0; k < L; ++k) t[k] = f.colors[(i + std::min<int64_t>(k, rows - 1)) * C + c];
      column[8 + c] = load(t);
      if (pose == 0) bad_color |= ~finite(column[8 + c]);
    }
    if (f.depth) column[8 + C] = p.z;
    const vi counts = (x1 - x0) * (y1 - y0);
    vi slot;
    for (int k = 0; k < L; ++k) {
      slot[k] = (int32_t)pairs;
      pairs += counts[k];
    }
    column[13] = (vf)slot;
    column[14] = (vf)(x0 | y0 << 16);
    column[15] = (vf)(x1 - x0);

    Record* const records = f.records + pose * N + i;
    Placement* const placements = f.placements + pose * N + i;
    const int count = (int)std::min<int64_t>(rows, L);
    for (int group = 0; group < 16 / L; ++group) {
      transpose(column + group * L);
      for (int k = 0; k < count; ++k)
        store((float*)(records + k) + group * L, column[group * L + k]);
    }
    const vi columns_y = y1 - y0, columns_x = x1 - x0;
    vf place[4] = {p.z, (vf)(x0 | y0 << 16), (vf)(x1 | y1 << 16), (vf)slot};
    transpose_in_rows(place, place);
    for (int k = 0; k < count; ++k)
      std::memcpy(placements + k, (const char*)(place + k % 4) + k / 4 * 16, 16);
    std::memcpy(f.radii + pose * N + i, &radius, sizeof(int32_t) * count);
    for (int k = 0; k < count; ++k) {
      int32_t* const first = histogram + y0[k] * f.tiles_x + x0[k];
      if (columns_x[k] <= 2 && columns_y[k] <= 2) {  // nearly always, and then without a branch
        const int64_t right = columns_x[k] == 2, below = columns_y[k] == 2 ? f.tiles_x : 0;
        first[0] += columns_x[k] > 0;
        first[right] += columns_x[k] == 2;
        first[below] += columns_y[k] == 2;
        first[below + right] += (columns_x[k] == 2) & (columns_y[k] == 2);
      } else {
        for (int ty = 0; ty < columns_y[k]; ++ty)
          for (int tx = 0; tx < columns_x[k]; ++tx) ++first[ty * f.tiles_x + tx];
      }
    }
  }
  return (any(bad_mean) ? MEANS : 0) | (any(bad_covar) ? COVARS : 0) |
         (any(bad_opacity) ? OPACITIES : 0) | (any(bad_color) ? COLORS : 0);
}

// Hand a chunk's Gaussians to the tiles they meet.
void scatter_chunk(const Frame& f, int64_t pose, int64_t begin, int64_t end, int32_t* where) {
  const Placement* const placements = f.placements + pose * f.gaussians;
  for (int64_t i = begin; i < end; ++i) {
    const Placement p = placements[i];
    const uint64_t entry = (uint64_t)p.key << 32 | (uint64_t)i;
    for (int ty = p.y0; ty < p.y1; ++ty)
      for (int tx = p.x0; tx < p.x1; ++tx) f.unsorted[where[ty * f.tiles_x + tx]++] = entry;
  }
}

// ------------------------------------------------------------------------------------------ tiles

// Sort by depth, then by number. Two passes over the 16 leading bits in use bring every entry near
// its place and insertion finishes; long lists pass over all bits in use.
void sort_by_depth(uint64_t* a, uint64_t* b, int64_t n, int32_t* numbers) {
  uint32_t low = ~0u, high = 0;
  for (int64_t i = 0; i < n; ++i) {
    const uint32_t key = (uint32_t)(a[i] >> 32);
    low = std::min(low, key);
    high = std::max(high, key);
  }
  const int bits = high > low ? 32 - __builtin_clz(high - low) : 0;
  const int passes = n > 1024 ? (bits + 7) / 8 : std::min((bits + 7) / 8, n > 24 ? 2 : 0);
  int shift = n > 1024 ? 0 : std::max(0, bits - 16);
  for (int pass = 0; pass < passes; ++pass, shift += 8) {
    int32_t start[256] = {};
    for (int64_t i = 0; i < n; ++i) ++start[((uint32_t)(a[i] >> 32) - low) >> shift & 255];
    int32_t sum = 0;
    for (int d = 0; d < 256; ++d) {
      const int32_t count = start[d];
      start[d] = sum;
      sum += count;
    }
    for (int64_t i = 0; i < n; ++i)
      b[start[((uint32_t)(a[i] >> 32) - low) >> shift & 255]++] = a[i];
    std::swap(a, b);
  }
  for (int64_t i = 1; i < n; ++i) {
    const uint64_t entry = a[i];
    int64_t j = i;
    for (; j > 0 && a[j - 1] > entry; --j) a[j] = a[j - 1];
    a[j] = entry;
  }
  for (int64_t i = 0; i < n; ++i) numbers[i] = (int32_t)(uint32_t)a[i];
}

// Where a tile's pixels are.
struct Tile {
  int64_t pose, number;
  int x0, y0, width, height;

  Tile(const Frame& f, int64_t pose, int64_t tile) : pose(pose), number(tile) {
    x0 = (int)(tile % f.tiles_x) * TILE_W;
    y0 = (int)(tile / f.tiles_x) * TILE_H;
    width = std::min<int>(TILE_W, (int)f.width - x0);
    height = std::min<int>(TILE_H, (int)f.height - y0);
  }
};

// Pixel centres of the first block of a tile, and of the tile's other blocks.
struct Grid {
  vf x, y;

  explicit Grid(const Tile& tile) {
    for (int i = 0; i < L; ++i) {
      x[i] = tile.x0 + i % BLOCK_W + 0.5f;
      y[i] = tile.y0 + i / BLOCK_W + 0.5f;
    }
  }
  static float dx(int block) { return (float)(block % GRID_W * BLOCK_W); }
  static float dy(int block) { return (float)(block / GRID_W * BLOCK_H); }
};

// Copy the records of up to SEGMENT pairs next to each other.
inline void copy_records(const Record* records, const int32_t* numbers, int n, Record* to) {
  constexpr int AHEAD = 32;
  for (int j = 0; j < n; ++j) {
    __builtin_prefetch(records + numbers[std::min(j + AHEAD, n - 1)]);
    to[j] = records[numbers[j]];
  }
}

// Find the blocks that each pair visits, one lane a block: the largest exponent over the block's
// rectangle of pixel centres lies at the Gaussian's centre or on an edge that faces it.
inline void find_visits(const Tile& tile, const Record* records, int n, Visits* visits) {
  const vf threshold = splat(LOG2_MIN_ALPHA - 1e-4f), zero = splat(0.0f);
  for (int part = 0; part < BLOCKS / L; ++part) {
    vf left, top;
    for (int i = 0; i < L; ++i) {
      left[i] = tile.x0 + 0.5f + Grid::dx(part * L + i);
      top[i] = tile.y0 + 0.5f + Grid::dy(part * L + i);
    }
    const vf right = left + (float)(BLOCK_W - 1), bottom = top + (float)(BLOCK_H - 1);
    for (int start = 0; start < n; start += 32) {
      const int count = std::min(32, n - start);
      vi word = {};
      for (int j = 0; j < count; ++j) {
        const Record& r = records[start + j];
        const vf x0 = left - r.x, x1 = right - r.x, y0 = top - r.y, y1 = bottom - r.y;
        const vf dx = clamp(zero, x0, x1), dy = clamp(zero, y0, y1);
        const vf along_y = clamp(r.steer_y * dx, y0, y1), along_x = clamp(r.steer_x * dy, x0, x1);
        const vf on_side = (r.a * dx + r.b * along_y) * dx + r.c * along_y * along_y;
        const vf on_top = (r.a * along_x + r.b * dy) * along_x + r.c * dy * dy;
        const vi meets = max(on_side, on_top) >= threshold - r.logo;
        word |= meets & (int32_t)(1u << j);
      }
      std::memcpy(visits[start / GROUP].half[start / 32 % 2] + part * L, &word, sizeof word);
    }
    if ((n + 31) / 32 % 2) {
      const vi none = {};
      std::memcpy(visits[n / GROUP].half[1] + part * L, &none, sizeof none);
    }
  }
}

// List the pairs that visit a block, filled up to a multiple of M by one that never shows.
inline int list_visits(const Visits* visits, int groups, int block, int32_t* list) {
  int count = 0;
  for (int g = 0; g < groups; ++g)
    for (uint64_t word = visits[g].word(block); word; word &= word - 1)
      list[count++] = g * GROUP + __builtin_ctzll(word);
  const int listed = count;
  while (count % M) list[count++] = SEGMENT;
  return listed;
}

// Records of one segment, and the one that never shows.
struct Segment {
  Record records[SEGMENT + 1];

  Segment() {
    std::memset(records + SEGMENT, 0, sizeof(Record));
    records[SEGMENT].logo = -1e30f;
  }
};

// Front to back, state in registers. `through` is the transmittance; it goes on falling below
// MIN_TRANSMITTANCE, where a pixel is finished and nothing counts, so that no flag is needed.
template <int V>
struct State {
  vf seen[V];   // sum of weight times value
  vf through;   // running
  vf last;      // before the pixel was finished

  bool finished() const { return !any(through > MIN_TRANSMITTANCE); }
};

// Composite one segment over one block; returns whether all its pixels are finished.
template <int V>
inline bool composite_block(const Record* records, Visits* visits, int groups, int block, vf px,
                            vf py, State<V>& out) {
  int32_t list[SEGMENT + M];
  const int count = list_visits(visits, groups, block, list);
  State<V> s = out;
  const vf least = splat(LOG2_MIN_ALPHA), most = splat(MAX_ALPHA);
  int at = 0;
  while (at < count) {
    const Record* r[M];
    for (int i = 0; i < M; ++i) r[i] = records + list[at + i];
    const Many dx = each([&](int i) { return px - r[i]->x; });
    const Many dy = each([&](int i) { return py - r[i]->y; });
    Many slope = each([&](int i) { return r[i]->a * dx[i]; });
    Many power = each([&](int i) { return r[i]->c * dy[i]; });
    slope = each([&](int i) { return r[i]->b * dy[i] + slope[i]; });
    power = each([&](int i) { return power[i] * dy[i] + r[i]->logo; });
    power = slope * dx + power;
    Many alpha = exp2(power);
    alpha = each([&](int i) { return only(power[i] >= least, min(alpha[i], most)); });
    const Many kept = each([&](int i) { return 1.0f - alpha[i]; });
    vf through[M + 1];
    through[0] = s.through;
    for (int i = 0; i < M; ++i) through[i + 1] = through[i] * kept[i];
    for (int i = 0; i < M; ++i) {
      const vi alive = through[i + 1] > MIN_TRANSMITTANCE;
      const vf weight = only(alive, alpha[i] * through[i]);
      for (int v = 0; v < V; ++v) s.seen[v] += weight * r[i]->value[v];
      s.last = alive ? through[i + 1] : s.last;
    }
    s.through = through[M];
    at += M;
    if (at % 16 == 0 && s.finished()) break;
  }
  out = s;
  if (at >= count) return s.finished();
  // The way back need not look at the rest either.
  const int rest = list[at];
  for (int g = rest / GROUP; g < groups; ++g) {
    const uint64_t keep = g > rest / GROUP ? 0 : ((uint64_t)1 << rest % GROUP) - 1;
    visits[g].half[0][block] &= (int32_t)(uint32_t)keep;
    visits[g].half[1][block] &= (int32_t)(uint32_t)(keep >> 32);
  }
  return true;
}

// Composite one busy tile into `states` ([BLOCKS][V + 1][L]: seen, last).
template <int V>
void composite_tile(const Frame& f, const Tile& tile, float* states) {
  const int64_t at = tile.pose * (tiles_of(f) + 1) + tile.number;
  const int64_t begin = f.tile_start[at], n = f.tile_start[at + 1] - begin;
  const int64_t busy = f.busy_index[tile.pose * tiles_of(f) + tile.number];
  sort_by_depth(f.unsorted + begin, f.unsorted + f.pairs + begin, n, f.sorted + begin);

  Segment segment;
  Record* const records = segment.records;
  Visits scratch[SEGMENT / GROUP];
  State<V> state[BLOCKS];
  bool finished[BLOCKS] = {};
  for (int k = 0; k < BLOCKS; ++k) {
    for (int v = 0; v < V; ++v) state[k].seen[v] = splat(0.0f);
    state[k].through = state[k].last = splat(1.0f);
  }
  const Grid grid(tile);
  int64_t done = 0;
  int left = BLOCKS;
  while (done < n && left) {
    const int m = (int)std::min<int64_t>(SEGMENT, n - done);
    const int groups = (m + GROUP - 1) / GROUP;
    Visits* const visits =
        f.keep ? f.visits + begin / GROUP + busy + done / GROUP : scratch;
    copy_records(f.records + tile.pose * f.gaussians, f.sorted + begin + done, m, records);
    find_visits(tile, records, m, visits);
    for (int k = 0; k < BLOCKS; ++k) {
      if (finished[k]) {
        for (int g = 0; g < groups; ++g) visits[g].half[0][k] = visits[g].half[1][k] = 0;
        continue;
      }
      finished[k] = composite_block<V>(records, visits, groups, k, grid.x + Grid::dx(k),
                                       grid.y + Grid::dy(k), state[k]);
      left -= finished[k];
    }
    done += m;
  }
  if (f.keep) f.composited[busy] = (int32_t)done;
  for (int k = 0; k < BLOCKS; ++k) {
    for (int v = 0; v < V; ++v) store(states + (k * (V + 1) + v) * L, state[k].seen[v]);
    store(states + (k * (V + 1) + V) * L, state[k].last);
  }
}

// Write a composited tile to the picture.
template <int V>
void write_tile(const Frame& f, const Tile& tile, int64_t picture, const float* states) {
  const int C = (int)f.channels;
  for (int y = 0; y < tile.height; ++y) {
    const int64_t row = (picture * f.height + tile.y0 + y) * f.width + tile.x0;
    for (int x = 0; x < tile.width; ++x) {
      const int block = y / BLOCK_H * GRID_W + x / BLOCK_W;
      const float* const s = states + block * (V + 1) * L + y % BLOCK_H * BLOCK_W + x % BLOCK_W;
      const float through = s[V * L];
      for (int c = 0; c < C; ++c)
        f.image[(row + x) * C + c] = s[c * L] + through * (f.background ? f.background[c] : 0.0f);
      f.alpha[row + x] = 1.0f - through;
      if (f.depth) f.depths[row + x] = s[C * L];
    }
  }
}

// An empty tile shows the background.
void write_empty_tile(const Frame& f, const Tile& tile, int64_t picture) {
  const int C = (int)f.channels;
  for (int y = 0; y < tile.height; ++y) {
    const int64_t row = (picture * f.height + tile.y0 + y) * f.width + tile.x0;
    float* const image = f.image + row * C;
    if (f.background) {
      for (int x = 0; x < tile.width; ++x)
        for (int c = 0; c < C; ++c) image[x * C + c] = f.background[c];
    } else {
      std::memset(image, 0, sizeof(float) * C * tile.width);
    }
    std::memset(f.alpha + row, 0, sizeof(float) * tile.width);
    if (f.depth) std::memset(f.depths + row, 0, sizeof(float) * tile.width);
  }
}

// One tile of one picture; of the mean picture, all poses in turn.
template <int V>
void render_tile(const Frame& f, int64_t picture, int64_t t) {
  constexpr int SIZE = BLOCKS * (V + 1) * L;
  alignas(64) float scratch[SIZE], sum[SIZE];
  const int64_t first = f.average ? 0 : picture, last = f.average ? f.poses : picture + 1;
  int64_t rendered = 0;
  const float* states = nullptr;
  for (int64_t pose = first; pose < last; ++pose) {
    const int64_t busy = f.busy_index[pose * tiles_of(f) + t];
    if (busy < 0) continue;
    float* const to = f.keep ? f.states + busy * SIZE : scratch;
    composite_tile<V>(f, Tile(f, pose, t), to);
    states = to;
    if (!f.average) continue;
    for (int i = 0; i < SIZE; i += L)
      store(sum + i, rendered ? load(sum + i) + load(to + i) : load(to + i));
    ++rendered;
  }
  const Tile tile(f, picture, t);
  if (!states) return write_empty_tile(f, tile, picture);
  if (f.average) {
    const float clear = (float)(f.poses - rendered), scale = 1.0f / f.poses;
    for (int k = 0; k < BLOCKS; ++k)
      for (int v = 0; v <= V; ++v) {
        float* const s = sum + (k * (V + 1) + v) * L;
        store(s, (load(s) + (v == V ? clear : 0.0f)) * scale);
      }
    states = sum;
  }
  write_tile<V>(f, tile, picture, states);
}

template <int V>
void render(const Frame& f) {
  const int64_t pictures = f.average ? 1 : f.poses, tiles = tiles_of(f);
#pragma omp parallel for schedule(dynamic, 1) num_threads((int)f.threads)
  for (int64_t i = 0; i < pictures * tiles; ++i) render_tile<V>(f, i / tiles, i % tiles);
}

// ------------------------------------------------------------------------------------ the way back

// What a slot holds: six moments of g = alpha dLoss/dalpha about the Gaussian's centre, the values'
// gradients, and the absolute gradients of the centre.
enum { S0, SX, SY, SXX, SXY, SYY, SV };
template <int V>
constexpr int SLOT = (SV + V + 2 + 3) / 4 * 4;

// What L visits of one block found, before the sums over its pixels.
struct Batch {
  vf alpha[L], slope_x[L], slope_y[L];
  vf g[L], weight[L], mean_grad[L];
  alignas(64) float x[L], y[L];
};

// Sum a batch over its pixels and add it to its pairs: one lane a pixel becomes one lane a visit.
// Within the rows of its vectors first (x), then across (y).
template <int V>
__attribute__((noinline)) void add_batch(const Batch& batch, const int32_t* pairs, int count,
                                         const vf* value_grad, float px, float py, float* sums) {
  vf grad[V][4];
  for (int v = 0; v < V; ++v) {
    grad[v][0] = splat_in_rows<0>(value_grad[v]), grad[v][1] = splat_in_rows<1>(value_grad[v]);
    grad[v][2] = splat_in_rows<2>(value_grad[v]), grad[v][3] = splat_in_rows<3>(value_grad[v]);
  }
  vf m0[ROWS], m1[ROWS], m2[ROWS], values[V][ROWS], pull_x[ROWS], pull_y[ROWS];
  for (int i = 0; i < ROWS; ++i) {
    vf t[4];
    transpose_in_rows(batch.g + 4 * i, t);
    m0[i] = (t[0] + t[1]) + (t[2] + t[3]);
    m1[i] = t[1] + 2.0f * t[2] + 3.0f * t[3];
    m2[i] = t[1] + 4.0f * t[2] + 9.0f * t[3];
    transpose_in_rows(batch.weight + 4 * i, t);
    for (int v = 0; v < V; ++v)
      values[v][i] =
          (t[0] * grad[v][0] + t[1] * grad[v][1]) + (t[2] * grad[v][2] + t[3] * grad[v][3]);
    transpose_in_rows(batch.mean_grad + 4 * i, t);
    pull_x[i] = t[0] + t[1], pull_y[i] = t[2] + t[3];
  }
  transpose_rows(m0, 1);
  transpose_rows(m1, 1);
  vf s0 = m0[0], sx = m1[0], sy = splat(0.0f), sxy = sy, syy = sy;
  const vf sxx = sum_of_rows(m2);
  for (int y = 1; y < ROWS; ++y) {
    s0 += m0[y], sx += m1[y];
    sy += (float)y * m0[y], sxy += (float)y * m1[y], syy += (float)(y * y) * m0[y];
  }
  // From the block's first pixel to each Gaussian's centre.
  const vf ox = px - load(batch.x), oy = py - load(batch.y);
  const vf mx = sx + ox * s0, my = sy + oy * s0;
  vf out[16] = {s0, mx, my, sxx + ox * (sx + mx), sxy + ox * sy + oy * mx, syy + oy * (sy + my)};
  for (int v = 0; v < V; ++v) out[SV + v] = sum_of_rows(values[v]);
  out[SV + V] = sum_of_rows(pull_x), out[SV + V + 1] = sum_of_rows(pull_y);

  constexpr int PARTS = (SLOT<V> + L - 1) / L;
  for (int part = 0; part < PARTS; ++part) {
    transpose(out + part * L);
    for (int k = 0; k < count; ++k) {
      float* const to = sums + pairs[k] * 16 + part * L;
      store(to, load(to) + out[part * L + k]);
    }
  }
}

// `rest` is what the loss gains from all that is still behind: it starts as the whole pixel's.
template <int V>
inline void differentiate_block(const Record* records, const Visits* visits, int groups, int block,
                                vf px, vf py, const vf* value_grad, vf& through_, vf& rest_,
                                float* sums) {
  int32_t list[SEGMENT + M];
  const int count = list_visits(visits, groups, block, list);
  Batch batch;
  vf rest = rest_, before = through_;
  const vf least = splat(LOG2_MIN_ALPHA), most = splat(MAX_ALPHA);
  for (int at = 0; at < count; at += L) {
    const int n = std::min(L, count - at);
    for (int k = 0; k < n; k += M) {  // what does not depend on the visits before
      const Record* r[M];
      for (int i = 0; i < M; ++i) r[i] = records + list[at + k + i];
      const Many dx = each([&](int i) { return px - r[i]->x; });
      const Many dy = each([&](int i) { return py - r[i]->y; });
      const Many adx = each([&](int i) { return r[i]->a * dx[i]; });
      const Many cdy = each([&](int i) { return r[i]->c * dy[i]; });
      const Many slope = each([&](int i) { return r[i]->b * dy[i] + adx[i]; });
      for (int i = 0; i < M; ++i) {
        batch.x[k + i] = r[i]->x, batch.y[k + i] = r[i]->y;
        batch.slope_x[k + i] = slope[i] + adx[i];
        batch.slope_y[k + i] = r[i]->b * dx[i] + (cdy[i] + cdy[i]);
      }
      Many power = each([&](int i) { return cdy[i] * dy[i] + r[i]->logo; });
      power = slope * dx + power;
      const Many alpha = exp2(power);
      for (int i = 0; i < M; ++i)
        batch.alpha[k + i] = only(power[i] >= least, min(alpha[i], most));
    }
    for (int k = 0; k < n; k += M) {
      const Record* r[M];
      for (int i = 0; i < M; ++i) r[i] = records + list[at + k + i];
      const Many alpha = each([&](int i) { return batch.alpha[k + i]; });
      const Many kept = each([&](int i) { return 1.0f - alpha[i]; });
      vf through[M + 1], after[M + 1];
      through[0] = before;
      for (int i = 0; i < M; ++i) through[i + 1] = through[i] * kept[i];
      before = through[M];
      Many gain = each([&](int i) { return value_grad[0] * r[i]->value[0]; });
      for (int v = 1; v < V; ++v)
        gain = each([&](int i) { return value_grad[v] * r[i]->value[v] + gain[i]; });
      vi alive[M];
      for (int i = 0; i < M; ++i) alive[i] = through[i + 1] > MIN_TRANSMITTANCE;
      const Many weight = each([&](int i) { return only(alive[i], alpha[i] * through[i]); });
      after[0] = rest;
      for (int i = 0; i < M; ++i) after[i + 1] = after[i] - weight[i] * gain[i];
      rest = after[M];
      const Many behind = each([&](int i) { return after[i + 1] / kept[i]; });
      for (int i = 0; i < M; ++i) {
        // No gradient through alpha where MAX_ALPHA holds it.
        const vf alpha_grad = through[i] * gain[i] - behind[i];
        const vf moment = only(alive[i] & (alpha[i] < most), alpha[i] * alpha_grad);
        batch.g[k + i] = moment;
        batch.weight[k + i] = weight[i];
        const vf x = abs(moment * batch.slope_x[k + i]), y = abs(moment * batch.slope_y[k + i]);
        batch.mean_grad[k + i] = join_first(x, y) + join_last(x, y);
      }
    }
    add_batch<V>(batch, list + at, n, value_grad, px[0], py[0], sums);
  }
  through_ = before, rest_ = rest;
}

// Gradients of one tile's pixels, one vector a block and value, and what the loss gains from each.
template <int V>
inline void load_gradients(const Frame& f, const Tile& tile, const float* states,
                           vf (*value_grad)[V], vf* rest) {
  const int C = (int)f.channels;
  const int64_t picture = f.average ? 0 : tile.pose;
  const float scale = f.average ? 1.0f / f.poses : 1.0f;
  alignas(64) float grads[BLOCKS][V + 1][L];
  const bool whole = tile.width == TILE_W && tile.height == TILE_H;
  std::memset(grads, 0, sizeof grads);
  for (int y = 0; y < tile.height; ++y) {
    const int64_t row = (picture * f.height + tile.y0 + y) * f.width + tile.x0;
    float* const to = &grads[y / BLOCK_H * GRID_W][0][y % BLOCK_H * BLOCK_W];
    const auto copy = [&](int value, const float* from, int stride) {
      if (!from) return;
      float* const start = to + value * L;
      if (whole) {
        for (int x = 0; x < TILE_W; ++x)
          start[x / BLOCK_W * (V + 1) * L + x % BLOCK_W] = from[x * stride];
      } else {
        for (int x = 0; x < tile.width; ++x)
          start[x / BLOCK_W * (V + 1) * L + x % BLOCK_W] = from[x * stride];
      }
    };
    for (int c = 0; c < C; ++c) copy(c, f.image_grad ? f.image_grad + row * C + c : nullptr, C);
    if (f.depth) copy(C, f.depths_grad ? f.depths_grad + row : nullptr, 1);
    copy(V, f.alpha_grad ? f.alpha_grad + row : nullptr, 1);
  }
  for (int k = 0; k < BLOCKS; ++k) {
    const float* const s = states + k * (V + 1) * L;
    const vf through = load(s + V * L);
    rest[k] = -scale * load(grads[k][V]) * through;
    for (int v = 0; v < V; ++v) {
      value_grad[k][v] = scale * load(grads[k][v]);
      const float backdrop = f.background && v < C ? f.background[v] : 0.0f;
      rest[k] += value_grad[k][v] * (load(s + v * L) + through * backdrop);
    }
  }
}

template <int V>
void differentiate_tile(const Frame& f, int64_t busy, int64_t first_slot) {
  const Tile tile(f, f.busy_tiles[busy] / tiles_of(f), f.busy_tiles[busy] % tiles_of(f));
  const int64_t at = tile.pose * (tiles_of(f) + 1) + tile.number;
  const int64_t begin = f.tile_start[at], n = f.tile_start[at + 1] - begin;
  const int64_t composited = f.composited[busy];
  const int32_t* const chunk_slot = f.chunk_slot + tile.pose * (f.chunks + 1);
  const int tile_x = tile.x0 / TILE_W, tile_y = tile.y0 / TILE_H;
  const Record* const all = f.records + tile.pose * f.gaussians;

  Segment segment;
  Record* const records = segment.records;
  alignas(64) float sums[(SEGMENT + 1) * 16];
  float* slots[SEGMENT];
  vf value_grad[BLOCKS][V], through[BLOCKS], rest[BLOCKS];
  load_gradients<V>(f, tile, f.states + busy * BLOCKS * (V + 1) * L, value_grad, rest);
  for (int k = 0; k < BLOCKS; ++k) through[k] = splat(1.0f);
  const Grid grid(tile);
  for (int64_t done = 0; done < n; done += SEGMENT) {
    const int m = (int)std::min<int64_t>(SEGMENT, n - done);
    const int32_t* const numbers = f.sorted + begin + done;
    std::memset(sums, 0, sizeof(float) * 16 * m);
    copy_records(all, numbers, m, records);
    for (int j = 0; j < m; ++j) {
      const Record& r = records[j];
      const int64_t slot = chunk_slot[numbers[j] >> f.chunk_shift] + r.slot +
                           (tile_y - r.tile_y) * r.tile_columns + (tile_x - r.tile_x);
      slots[j] = f.slots + (slot - first_slot) * SLOT<V>;
      __builtin_prefetch(slots[j], 1);
    }
    if (done < composited) {
      const Visits* const visits = f.visits + begin / GROUP + busy + done / GROUP;
      for (int k = 0; k < BLOCKS; ++k)
        differentiate_block<V>(records, visits, (m + GROUP - 1) / GROUP, k, grid.x + Grid::dx(k),
                               grid.y + Grid::dy(k), value_grad[k], through[k], rest[k], sums);
    }
    for (int j = 0; j < m; ++j) std::memcpy(slots[j], sums + j * 16, sizeof(float) * SLOT<V>);
  }
}

// Write `columns` vectors as rows, or add them to the rows that are there.
inline void add_rows(float* to, int rows, int columns, bool add, const vf* from) {
  for (int k = 0; k < rows; ++k)
    for (int c = 0; c < columns; ++c)
      to[k * columns + c] = (add ? to[k * columns + c] : 0.0f) + from[c][k];
}

// The gradient of a covariance in the form of the argument. Of six numbers, those off the diagonal
// stand for two entries each.
__attribute__((noinline)) void store_covar_grads(const Frame& f, int64_t row, int64_t rows,
                                                 bool add, const vf* g) {
  const vf six[6] = {g[0], 2.0f * g[1], 2.0f * g[2], g[3], 2.0f * g[4], g[5]};
  const vf nine[9] = {g[0], g[1], g[2], g[1], g[3], g[4], g[2], g[4], g[5]};
  float* const to = f.covars_grad + row * f.covar_columns;
  const int count = (int)std::min<int64_t>(rows, L);
  if (add) {
    f.covar_columns == 6 ? add_rows(to, count, 6, true, six) : add_rows(to, count, 9, true, nine);
  } else {
    f.covar_columns == 6 ? store_rows<6>(to, rows, six) : store_rows<9>(to, rows, nine);
  }
}

// Add up the slots of L Gaussians of one pose; returns which have any.
template <int V>
inline vi sum_slots(const Placement* placements, const float* slots, int count, vf* sums) {
  alignas(64) float rows[L][16] = {};
  vi seen = {};
  for (int k = 0; k < count; ++k) {
    const Placement p = placements[k];
    const int n = (p.x1 - p.x0) * (p.y1 - p.y0);
    const float* from = slots + (int64_t)p.slot * SLOT<V>;
    float sum[SLOT<V>] = {};
    for (int j = 0; j < n; ++j, from += SLOT<V>)
      for (int q = 0; q < SLOT<V>; ++q) sum[q] += from[q];
    std::memcpy(rows[k], sum, sizeof sum);
    seen[k] = n ? -1 : 0;
  }
  for (int part = 0; part < 16 / L; ++part) {
    for (int k = 0; k < L; ++k) sums[part * L + k] = load(rows[k] + part * L);
    transpose(sums + part * L);
  }
  return seen;
}

// Add up the slots of L Gaussians and carry them back through the projection, for poses [p0, p1).
void gather(const Frame& f, const Camera& cam, int64_t i, int64_t rows, int64_t p0, int64_t p1,
            int64_t first_slot) {
  const int64_t N = f.gaussians, C = f.channels;
  const int V = values_of(f) <= 3 ? 3 : 5;
  const int count = (int)std::min<int64_t>(rows, L);
  vf opacity[1], opacity_grad = splat(0.0f), color_grad[MAX_VALUES] = {}, shared_grad[6] = {};
  load_rows<1>(f.opacities + i, rows, opacity);
  for (int64_t pose = p0; pose < p1; ++pose) {
    const Placement* const placements = f.placements + pose * N + i;
    const int64_t chunk = f.chunk_slot[pose * (f.chunks + 1) + (i >> f.chunk_shift)] - first_slot;
    vf s[16], grad[3] = {}, covar_grad[6] = {}, mean_grad[2] = {}, abs_mean_grad[2] = {};
    const vi seen = V == 3 ? sum_slots<3>(placements, f.slots + chunk * SLOT<3>, count, s)
                           : sum_slots<5>(placements, f.slots + chunk * SLOT<5>, count, s);
    if (any(seen)) {
      vf mean[3], covar[6];
      load_rows<3>(f.means + (pose * N + i) * 3, rows, mean);
      load_covars(f, pose, i, rows, covar);
      const Projection p(cam, mean, covar);
      const vf one = splat(1.0f);
      // A Gaussian left out may have any conic; its gradient is zero whatever that is.
      const vf kxx = only(seen, p.conic_xx), kxy = only(seen, p.conic_xy);
      const vf kyy = only(seen, p.conic_yy);
      opacity_grad += only(seen, s[S0] / (seen ? opacity[0] : one));
      for (int64_t c = 0; c < C; ++c) color_grad[c] += s[SV + c];
      mean_grad[0] = kxx * s[SX] + kxy * s[SY], mean_grad[1] = kxy * s[SX] + kyy * s[SY];
      // In base 2 the slopes carry a factor -1 / ln 2.
      abs_mean_grad[0] = LN2 * s[SV + V], abs_mean_grad[1] = LN2 * s[SV + V + 1];
      // d covariance = 1/2 K S K
      const vf t00 = kxx * s[SXX] + kxy * s[SXY], t01 = kxx * s[SXY] + kxy * s[SYY];
      const vf t10 = kxy * s[SXX] + kyy * s[SXY], t11 = kxy * s[SXY] + kyy * s[SYY];
      const vf v00 = 0.5f * (t00 * kxx + t01 * kxy), v01 = 0.5f * (t00 * kxy + t01 * kyy);
      const vf v11 = 0.5f * (t10 * kxy + t11 * kyy);
      vf w0[3], w1[3];  // V M
      for (int k = 0; k < 3; ++k) {
        w0[k] = v00 * p.m0[k] + v01 * p.m1[k];
        w1[k] = v01 * p.m0[k] + v11 * p.m1[k];
      }
      const int row_of[6] = {0, 0, 0, 1, 1, 2}, column_of[6] = {0, 1, 2, 1, 2, 2};
      for (int k = 0; k < 6; ++k) {
        const int a = row_of[k], b = column_of[k];
        covar_grad[k] = only(seen, p.m0[a] * w0[b] + p.m1[a] * w1[b]);
      }
      // d M = 2 V M S; only its products with the rows of the rotation are needed.
      vf q00 = {}, q02 = {}, q11 = {}, q12 = {};
      for (int k = 0; k < 3; ++k) {
        const vf d0 = 2.0f * (v00 * p.s0[k] + v01 * p.s1[k]);
        const vf d1 = 2.0f * (v01 * p.s0[k] + v11 * p.s1[k]);
        q00 += d0 * cam.r[0][k], q02 += d0 * cam.r[2][k];
        q11 += d1 * cam.r[1][k], q12 += d1 * cam.r[2][k];
      }
      const vf scale_x = cam.fx * p.rz, scale_y = cam.fy * p.rz;
      // M_0 = fx rz (R_0 - clamped_x R_2), x = fx slope_x + cx, slope_x = p_x rz
      const vi free_x = p.slope_x == p.clamped_x, free_y = p.slope_y == p.clamped_y;
      const vf slope_x_grad = cam.fx * mean_grad[0] - only(free_x, scale_x * q02);
      const vf slope_y_grad = cam.fy * mean_grad[1] - only(free_y, scale_y * q12);
      const vf scale_grad =
          cam.fx * (q00 - p.clamped_x * q02) + cam.fy * (q11 - p.clamped_y * q12);
      const vf x_grad = p.rz * slope_x_grad, y_grad = p.rz * slope_y_grad;
      vf z_grad = -p.rz * (p.slope_x * slope_x_grad + p.slope_y * slope_y_grad + p.rz * scale_grad);
      if (f.depth) z_grad += s[SV + C];
      for (int k = 0; k < 3; ++k)
        grad[k] = only(seen, cam.r[0][k] * x_grad + cam.r[1][k] * y_grad + cam.r[2][k] * z_grad);
    }
    if (f.means_grad) store_rows<3>(f.means_grad + (pose * N + i) * 3, rows, grad);
    if (f.means2d_grad) store_rows<2>(f.means2d_grad + (pose * N + i) * 2, rows, mean_grad);
    if (f.means2d_absgrad) store_rows<2>(f.means2d_absgrad + (pose * N + i) * 2, rows, abs_mean_grad);
    if (f.covars_grad && !f.covars_shared)
      store_covar_grads(f, pose * N + i, rows, false, covar_grad);
    for (int k = 0; k < 6; ++k) shared_grad[k] += covar_grad[k];
  }
  // What the poses share is summed over them; groups of poses follow one another.
  if (f.opacities_grad) add_rows(f.opacities_grad + i, count, 1, p0 > 0, &opacity_grad);
  if (f.colors_grad) add_rows(f.colors_grad + i * C, count, (int)C, p0 > 0, color_grad);
  if (f.covars_grad && f.covars_shared) store_covar_grads(f, i, rows, p0 > 0, shared_grad);
}

template <int V>
void differentiate(const Frame& f) {
  const Camera cam(f);
  const int64_t groups_of_lanes = (f.gaussians + L - 1) / L;
  for (int64_t p0 = 0, p1; p0 < f.poses; p0 = p1) {
    // As many poses at once as have room for their slots, so that these stay in the cache.
    const int64_t first_slot = f.chunk_slot[p0 * (f.chunks + 1)];
    p1 = p0 + 1;
    while (p1 < f.poses &&
           f.chunk_slot[p1 * (f.chunks + 1) + f.chunks] - first_slot <= f.slot_capacity)
      ++p1;
#pragma omp parallel num_threads((int)f.threads)
    {
#pragma omp for schedule(dynamic, 1)
      for (int64_t i = f.busy_start[p0]; i < f.busy_start[p1]; ++i)
        differentiate_tile<V>(f, i, first_slot);
#pragma omp for schedule(static)
      for (int64_t i = 0; i < groups_of_lanes; ++i)
        gather(f, cam, i * L, f.gaussians - i * L, p0, p1, first_slot);
    }
  }
}

}  // namespace

extern "C" {

int64_t frame_bytes() { return sizeof(Frame); }
int64_t lanes() { return L; }
int64_t tile_width() { return TILE_W; }
int64_t tile_height() { return TILE_H; }
int64_t visits_bytes() { return sizeof(Visits); }
int64_t visits_group() { return GROUP; }
int64_t states_floats(int64_t values) { return BLOCKS * ((values <= 3 ? 3 : 5) + 1) * L; }
int64_t slot_floats(int64_t values) { return values <= 3 ? SLOT<3> : SLOT<5>; }

// Returns which inputs are not finite (NotFinite), or TOO_MANY_PAIRS; 0 if all is well.
int64_t project(Frame* frame) {
  Frame& f = *frame;
  const int64_t tiles = tiles_of(f), items = f.poses * f.chunks;
  const Camera cam(f);
  int bad = 0;
  int64_t pairs = 0;
#pragma omp parallel for schedule(dynamic, 1) num_threads((int)f.threads) reduction(| : bad) \
    reduction(+ : pairs)
  for (int64_t item = 0; item < items; ++item) {
    const int64_t pose = item / f.chunks, chunk = item % f.chunks;
    const int64_t begin = chunk << f.chunk_shift;
    const int64_t end = std::min(f.gaussians, (chunk + 1) << f.chunk_shift);
    int32_t* const histogram = f.histogram + item * tiles;
    std::memset(histogram, 0, sizeof(int32_t) * tiles);
    int64_t found;
    bad |= project_chunk(f, cam, pose, begin, end, histogram, found);
    f.chunk_slot[pose * (f.chunks + 1) + chunk] = (int32_t)found;
    pairs += found;
  }
  if (bad) return bad;
  if (pairs > INT32_MAX) return TOO_MANY_PAIRS;

  int32_t slot = 0;
  f.largest = 0;
  for (int64_t pose = 0; pose < f.poses; ++pose) {
    int32_t* const chunk_slot = f.chunk_slot + pose * (f.chunks + 1);
    const int32_t first = slot;
    for (int64_t chunk = 0; chunk < f.chunks; ++chunk) {
      const int32_t found = chunk_slot[chunk];
      chunk_slot[chunk] = slot;
      slot += found;
    }
    chunk_slot[f.chunks] = slot;
    f.largest = std::max<int64_t>(f.largest, slot - first);
  }
  // A pose's pairs lie together, tile by tile; within a tile chunk by chunk.
#pragma omp parallel for schedule(static) num_threads((int)f.threads)
  for (int64_t pose = 0; pose < f.poses; ++pose) {
    int32_t* const start = f.tile_start + pose * (tiles + 1);
    int32_t* const histogram = f.histogram + pose * f.chunks * tiles;
    int32_t at = f.chunk_slot[pose * (f.chunks + 1)], busy = 0;
    for (int64_t t = 0; t < tiles; ++t) {
      start[t] = at;
      for (int64_t chunk = 0; chunk < f.chunks; ++chunk) {
        const int32_t found = histogram[chunk * tiles + t];
        histogram[chunk * tiles + t] = at;
        at += found;
      }
      f.busy_index[pose * tiles + t] = at > start[t] ? busy++ : -1;
    }
    start[tiles] = at;
    f.busy_start[pose] = busy;
  }
  int32_t busy = 0;
  for (int64_t pose = 0; pose < f.poses; ++pose) {
    const int32_t found = f.busy_start[pose];
    f.busy_start[pose] = busy;
    for (int64_t t = 0; busy && t < tiles; ++t)
      if (f.busy_index[pose * tiles + t] >= 0) f.busy_index[pose * tiles + t] += busy;
    busy += found;
  }
  f.busy_start[f.poses] = busy;
  f.pairs = pairs;
  f.busy = busy;
  return 0;
}

void forward(Frame* frame) {
  const Frame& f = *frame;
  const int64_t tiles = tiles_of(f), items = f.poses * f.chunks;
#pragma omp parallel for schedule(dynamic, 1) num_threads((int)f.threads)
  for (int64_t item = 0; item < items; ++item) {
    const int64_t pose = item / f.chunks, chunk = item % f.chunks;
    scatter_chunk(f, pose, chunk << f.chunk_shift,
                  std::min(f.gaussians, (chunk + 1) << f.chunk_shift), f.histogram + item * tiles);
  }
  for (int64_t i = 0; f.keep && i < f.poses * tiles; ++i)
    if (f.busy_index[i] >= 0) f.busy_tiles[f.busy_index[i]] = (int32_t)i;
  const int64_t values = values_of(f);
  values <= 3 ? render<3>(f) : render<5>(f);
}

void backward(Frame* frame) {
  const Frame& f = *frame;
  const int64_t values = values_of(f);
  values <= 3 ? differentiate<3>(f) : differentiate<5>(f);
}

// The background shows through every pixel: the sum of its gradient times what is not covered. The
// rows are cut into as many parts whatever the number of threads, so the sum is always the same.
void backward_background(Frame* frame) {
  const Frame& f = *frame;
  constexpr int PARTS = 32;
  double sums[PARTS][4] = {};
  const int64_t rows = (f.average ? 1 : f.poses) * f.height, C = f.channels;
#pragma omp parallel for schedule(static) num_threads((int)f.threads)
  for (int64_t part = 0; part < PARTS; ++part)
    for (int64_t y = rows * part / PARTS; y < rows * (part + 1) / PARTS; ++y) {
      float row[4] = {};
      for (int64_t i = y * f.width; i < (y + 1) * f.width; ++i)
        for (int64_t c = 0; c < C; ++c) row[c] += f.image_grad[i * C + c] * (1.0f - f.alpha[i]);
      for (int64_t c = 0; c < C; ++c) sums[part][c] += row[c];
    }
  for (int64_t c = 0; c < C; ++c) {
    double sum = 0;
    for (int part = 0; part < PARTS; ++part) sum += sums[part][c];
    f.background_grad[c] = (float)sum;
  }
}

}  // extern "C"
