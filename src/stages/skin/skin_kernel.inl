// Kernels for one real type and one instruction set; included by skin_kernel_*.c with
//   REAL     float or double
//   INTEGER  integer of the same size
//   LANES    frames per register, divides PCI_BLOCK
//   ANY(mask)  whether any bit is set
//   NAME(x)  name of x for this type
//   ROWS     what skin_rows.inl made for this instruction set
//   FUSED(sum, x, y)  sum + x y of registers, rounded once, or EACH_FMA, x y + sum of numbers
//   ROOT(x)  square roots of a register, or EACH_ROOT, that of a number
//   LENGTH_TOLERANCE  see NAME(inverse_root)
//   STEP_TOLERANCE, CURVATURE_TOLERANCE  see NAME(search_rotation)
//   ROOT_TOLERANCE  see NAME(step_root)
// Vector types, loads and stores go through pointers to REAL, which are aligned to a register.

typedef REAL NAME(vec) __attribute__((vector_size(LANES * sizeof(REAL)), may_alias));
typedef INTEGER NAME(mask) __attribute__((vector_size(LANES * sizeof(REAL)), may_alias));
typedef REAL NAME(quad) __attribute__((vector_size(4 * sizeof(REAL)), may_alias));
#define QUAD NAME(quad)
#define VEC  NAME(vec)
#define MASK NAME(mask)

static inline __attribute__((always_inline)) const VEC *NAME(at)(const REAL *p) {
    return (const VEC *)(const void *)p;
}
static inline __attribute__((always_inline)) void NAME(store)(REAL *p, const VEC *value) {
    *(VEC *)(void *)p = *value;
}
#define LOAD(p) (*NAME(at)(p))
#define STORE(p, value)                                                                            \
    do {                                                                                           \
        const VEC stored_ = (value);                                                               \
        NAME(store)((p), &stored_);                                                                \
    } while (0)
#define SELECT(mask, yes, no) ((VEC)(((mask) & (MASK)(yes)) | (~(mask) & (MASK)(no))))

// A number in all lanes: whatever it is, it stays that when 0 is taken away.
static inline __attribute__((always_inline)) VEC NAME(all)(REAL x) { return x - (VEC){0}; }

#ifdef EACH_FMA
static inline __attribute__((always_inline)) VEC NAME(fused)(VEC sum, VEC x, VEC y) {
    for (size_t l = 0; l < LANES; ++l) {
        sum[l] = EACH_FMA(x[l], y[l], sum[l]);
    }
    return sum;
}
#define FUSED(sum, x, y) NAME(fused)(sum, x, y)
#endif

#ifdef EACH_ROOT
static inline __attribute__((always_inline)) VEC NAME(root)(VEC x) {
    for (size_t l = 0; l < LANES; ++l) {
        x[l] = EACH_ROOT(x[l]);
    }
    return x;
}
#define ROOT(x) NAME(root)(x)
#endif

// Row-major rotation matrix of a unit quaternion, minus the identity.
static inline __attribute__((always_inline)) void NAME(turn)(const VEC q[4], VEC r[9]) {
    const VEC tx = q[1] + q[1], ty = q[2] + q[2], tz = q[3] + q[3];
    const VEC wx = tx * q[0], wy = ty * q[0], wz = tz * q[0];
    const VEC xx = tx * q[1], xy = tx * q[2], xz = tx * q[3];
    const VEC yy = ty * q[2], yz = ty * q[3], zz = tz * q[3];
    r[0] = -(yy + zz), r[1] = xy - wz, r[2] = xz + wy;
    r[3] = xy + wz, r[4] = -(xx + zz), r[5] = yz - wx;
    r[6] = xz - wy, r[7] = yz + wx, r[8] = -(xx + yy);
}

// Solves failed lanes one by one.
static __attribute__((noinline)) void NAME(solve_lanes)(const VEC s[9], const MASK *failed,
                                                        VEC q[4]) {
    for (size_t l = 0; l < LANES; ++l) {
        if ((*failed)[l] != 0) {
            double single[9], quaternion[4];
            for (size_t k = 0; k < 9; ++k) {
                single[k] = (double)s[k][l];
            }
            pci_rotation_by_jacobi(single, quaternion);
            for (size_t k = 0; k < 4; ++k) {
                q[k][l] = (REAL)quaternion[k];
            }
        }
    }
}

// w = H^-1 g / 2 of a symmetric H, rows 00, 01, 02, 11, 12, 22. Returns where H is definite; what w
// is elsewhere does not matter.
static inline __attribute__((always_inline)) MASK NAME(half_step)(const VEC h[6], const VEC g[3],
                                                                  VEC w[3]) {
    // Cofactors of H; its leading minors tell definiteness.
    const VEC c00 = h[3] * h[5] - h[4] * h[4], c01 = h[2] * h[4] - h[1] * h[5];
    const VEC c02 = h[1] * h[4] - h[2] * h[3], c11 = h[0] * h[5] - h[2] * h[2];
    const VEC c12 = h[1] * h[2] - h[0] * h[4], c22 = h[0] * h[3] - h[1] * h[1];
    const VEC det = h[0] * c00 + h[1] * c01 + h[2] * c02;
    const MASK definite = (h[0] > 0) & (c22 > 0) & (det > 0);
    const VEC half = (REAL)0.5 / SELECT(definite, det, (VEC){0} + (REAL)1);
    w[0] = half * (c00 * g[0] + c01 * g[1] + c02 * g[2]);
    w[1] = half * (c01 * g[0] + c11 * g[1] + c12 * g[2]);
    w[2] = half * (c02 * g[0] + c12 * g[1] + c22 * g[2]);
    return definite;
}

static inline __attribute__((always_inline)) VEC NAME(absolute)(VEC x) {
    return SELECT(x < 0, -x, x);
}

static inline __attribute__((always_inline)) VEC NAME(inverse_root)(VEC x) {
    return (REAL)1 / ROOT(x + (REAL)LENGTH_TOLERANCE);
}

// The rotation R = I + r that maximises tr(R^T S), in place of the first guess q, a unit
// quaternion.
//
// Newton's method on R exp([w]). With P = R^T S the gradient is g = axial(P - P^T) and minus the
// Hessian is H = tr(P) I - sym(P). Turning a stationary R by an angle a about n changes the
// objective by -(1 - cos a) n^T H n exactly, so H >= 0 certifies the global optimum; and for want
// of a third derivative there, the error after a step is of the order of its third power. Where H
// is not definite it is made so for one step uphill. Lanes that end on a saddle or do not converge
// are solved by Jacobi rotations. S is scaled to about 1.
static __attribute__((noinline)) void NAME(search_rotation)(const VEC s[9], MASK running, VEC q[4],
                                                            VEC r[9]) {
    MASK failed = (MASK){0};
    for (int step = 0; step < 16; ++step) {
        VEC p[9], w[3];
        NAME(turn)(q, r);
        for (size_t i = 0; i < 3; ++i) {
            for (size_t j = 0; j < 3; ++j) {
                p[3 * i + j] =
                    s[3 * i + j] + (r[i] * s[j] + r[3 + i] * s[3 + j] + r[6 + i] * s[6 + j]);
            }
        }
        const VEC g[3] = {p[7] - p[5], p[2] - p[6], p[3] - p[1]};
        VEC h[6] = {p[4] + p[8] + (REAL)CURVATURE_TOLERANCE,
                    (REAL)-0.5 * (p[1] + p[3]),
                    (REAL)-0.5 * (p[2] + p[6]),
                    p[0] + p[8] + (REAL)CURVATURE_TOLERANCE,
                    (REAL)-0.5 * (p[5] + p[7]),
                    p[0] + p[4] + (REAL)CURVATURE_TOLERANCE};
        const MASK lost = running & ~NAME(half_step)(h, g, w);
        if (ANY(lost)) {
            VEC shift = NAME(absolute)(h[1]) + NAME(absolute)(h[2]) + NAME(absolute)(h[4]);
            shift += shift + NAME(absolute)(h[0]) + NAME(absolute)(h[3]) + NAME(absolute)(h[5]);
            shift = SELECT(lost, shift, (VEC){0});
            h[0] += shift, h[3] += shift, h[5] += shift;
            running &= NAME(half_step)(h, g, w);
        }
        const VEC length = w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
        const MASK moving = running & ~(length < (REAL)STEP_TOLERANCE);
        failed |= lost & ~moving;
        if (ANY(moving)) { // at most one radian
            const VEC factor =
                (REAL)0.25 / SELECT(length > (REAL)0.25, length, (VEC){0} + (REAL)0.25);
            w[0] *= factor, w[1] *= factor, w[2] *= factor;
        }
        // q (1, w / 2), brought back to about length 1: exactly when the last step is small.
        const VEC q0 = q[0] - (q[1] * w[0] + q[2] * w[1] + q[3] * w[2]);
        const VEC q1 = q[1] + (q[0] * w[0] + q[2] * w[2] - q[3] * w[1]);
        const VEC q2 = q[2] + (q[0] * w[1] + q[3] * w[0] - q[1] * w[2]);
        const VEC q3 = q[3] + (q[0] * w[2] + q[1] * w[1] - q[2] * w[0]);
        const VEC n = q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3;
        const VEC unit = (REAL)1.5 - (REAL)0.5 * n;
        q[0] = SELECT(running, q0 * unit, q[0]), q[1] = SELECT(running, q1 * unit, q[1]);
        q[2] = SELECT(running, q2 * unit, q[2]), q[3] = SELECT(running, q3 * unit, q[3]);
        running = moving;
        if (!ANY(running)) {
            break;
        }
    }
    failed |= running;
    if (ANY(failed)) {
        NAME(solve_lanes)(s, &failed, q);
    }
    NAME(turn)(q, r);
}

// A matrix S on the way to the rotation R that maximises tr(R^T S).
//
// Horn, "Closed-form solution of absolute orientation using unit quaternions", 1987: R's quaternion
// is an eigenvector of the largest eigenvalue m of a symmetric 4 by 4 matrix; m is the sum of the
// singular values, with the sign of det S on the least. With 2 k = m^2 - |S|^2 it is the largest
// root of f = k^2 - 2 m det S - |cof S|^2. With g = axial(S - S^T) and
// A = (m + tr S) I - S - S^T the quaternion is parallel to (det A, adj(A) g), whose length is
// 4 f'(m) |w|, w the first number of the unit quaternion. A > 0 certifies that m is the largest: A
// is a block of m I less that matrix, its Schur complement is 0. Where the length is small R is a
// half turn or hardly determined, see find_again.
typedef struct NAME(fit) {
    VEC s[9];
    VEC squares, minors, det_2; // |S|^2, |cof S|^2, 2 det S
    VEC most, slope, value;     // m, f', f
    MASK running;               // lanes in which m is not found
} NAME(fit);

// The quaternion of R, of any length.
typedef struct NAME(quaternion) {
    VEC w, x, y, z;
    VEC sine, whole; // x^2 + y^2 + z^2, and w^2 with it
    VEC gain;        // tr((R - I)^T S) times `whole`; the error of m counts squared
} NAME(quaternion);

static inline __attribute__((always_inline)) VEC NAME(minor)(VEC a, VEC b, VEC c, VEC d) {
    return FUSED(a * b, -c, d);
}

static inline __attribute__((always_inline)) VEC NAME(dot)(const VEC *x, const VEC *y) {
    return FUSED(FUSED(x[0] * y[0], x[1], y[1]), x[2], y[2]);
}

// f and f' at m.
static inline __attribute__((always_inline)) void NAME(value_at_most)(NAME(fit) * f) {
    const VEC k_2 = FUSED(-f->squares, f->most, f->most), half = (REAL)0.5 * k_2;
    f->slope = FUSED(-f->det_2, k_2, f->most);
    f->value = FUSED(FUSED(-f->minors, half, half), -f->det_2, f->most);
}

// One step of Householder's method of third order from m to a closer one.
static inline __attribute__((always_inline)) void NAME(step_root)(NAME(fit) * f) {
    const VEC curve = FUSED(-f->squares, NAME(all)(3) * f->most, f->most); // f'' / 2
    const VEC bent = f->value * curve, slope_2 = f->slope * f->slope;
    const VEC step = f->value * FUSED(slope_2, NAME(all)((REAL)-0.5), bent);
    const VEC change = step / FUSED(f->slope * (slope_2 - bent), f->value * f->value, f->most);
    f->most -= change;
    NAME(value_at_most)(f);
}

// The last step, of Halley's method. Returns where it leaves an error.
static inline __attribute__((always_inline)) MASK NAME(end_root)(NAME(fit) * f) {
    const VEC curve = FUSED(-f->squares, NAME(all)(3) * f->most, f->most);
    const VEC change = f->value * f->slope / FUSED(f->slope * f->slope, -f->value, curve);
    const MASK far = ~(change * change * f->most < (REAL)ROOT_TOLERANCE * f->slope);
    f->most -= change;
    return far;
}

static inline __attribute__((always_inline)) void NAME(begin_fit)(NAME(fit) * f) {
    const VEC s[9] = {f->s[0], f->s[1], f->s[2], f->s[3], f->s[4],
                      f->s[5], f->s[6], f->s[7], f->s[8]};
    const VEC c[9] = {NAME(minor)(s[4], s[8], s[5], s[7]), NAME(minor)(s[5], s[6], s[3], s[8]),
                      NAME(minor)(s[3], s[7], s[4], s[6]), NAME(minor)(s[2], s[7], s[1], s[8]),
                      NAME(minor)(s[0], s[8], s[2], s[6]), NAME(minor)(s[1], s[6], s[0], s[7]),
                      NAME(minor)(s[1], s[5], s[2], s[4]), NAME(minor)(s[2], s[3], s[0], s[5]),
                      NAME(minor)(s[0], s[4], s[1], s[3])};
    const VEC det = NAME(dot)(&s[0], &c[0]);
    f->squares = NAME(dot)(&s[0], &s[0]) + NAME(dot)(&s[3], &s[3]) + NAME(dot)(&s[6], &s[6]);
    f->minors = NAME(dot)(&c[0], &c[0]) + NAME(dot)(&c[3], &c[3]) + NAME(dot)(&c[6], &c[6]);
    f->det_2 = det + det;
    // The first guess of m, exact where det S = 0.
    const VEC k = ROOT(f->minors), k_2 = k + k;
    f->most = ROOT(f->squares + k_2);
    f->slope = FUSED(-f->det_2, k_2, f->most);
    f->value = -f->det_2 * f->most;
}

// The quaternion of a matrix whose m is known. Returns where it is not to be trusted.
static inline __attribute__((always_inline)) MASK NAME(quaternion_by_root)(const VEC s[9], VEC most,
                                                                           NAME(quaternion) * q) {
    const VEC g[3] = {s[7] - s[5], s[2] - s[6], s[3] - s[1]};
    const VEC pair = s[4] + s[8], sum = most + s[0];
    const VEC a00 = (most - s[0]) + pair, a11 = sum + (s[8] - s[4]), a22 = sum + (s[4] - s[8]);
    const VEC n01 = s[1] + s[3], n02 = s[2] + s[6], n12 = s[5] + s[7]; // those of -A
    const VEC c00 = NAME(minor)(a11, a22, n12, n12), c01 = FUSED(n01 * a22, n02, n12);
    const VEC c02 = FUSED(n02 * a11, n01, n12), c11 = NAME(minor)(a00, a22, n02, n02);
    const VEC c12 = FUSED(a00 * n12, n01, n02), c22 = NAME(minor)(a00, a11, n01, n01);
    q->w = FUSED(FUSED(a00 * c00, -n01, c01), -n02, c02);
    q->x = FUSED(FUSED(c00 * g[0], c01, g[1]), c02, g[2]);
    q->y = FUSED(FUSED(c01 * g[0], c11, g[1]), c12, g[2]);
    q->z = FUSED(FUSED(c02 * g[0], c12, g[1]), c22, g[2]);
    q->sine = FUSED(FUSED(q->x * q->x, q->y, q->y), q->z, q->z);
    q->whole = FUSED(q->sine, q->w, q->w);
    const VEC turned = FUSED(FUSED(q->x * g[0], q->y, g[1]), q->z, g[2]);
    q->gain = FUSED(q->sine * (most - (s[0] + pair)), q->w, turned);
    const VEC least = (REAL)0.04 * (most * most * most);
    return ~(a00 > 0) | ~(c22 > 0) | ~(q->w > 0) | ~(q->whole > least * least);
}

// `factor` times R - I of a quaternion of any length. Returns tr((R - I)^T S).
static inline __attribute__((always_inline)) VEC NAME(matrix)(const NAME(quaternion) * q,
                                                              REAL factor, VEC turn[9]) {
    const VEC inverse = (REAL)1 / q->whole, share = (REAL)2 * factor * inverse, w = share * q->w;
    const VEC x = share * q->x, y = share * q->y, z = share * q->z;
    const VEC wx = w * q->x, wy = w * q->y, wz = w * q->z;
    const VEC xx = x * q->x, xy = x * q->y, xz = x * q->z;
    const VEC yy = y * q->y, yz = y * q->z, zz = z * q->z;
    turn[0] = -(yy + zz), turn[1] = xy - wz, turn[2] = xz + wy;
    turn[3] = xy + wz, turn[4] = -(xx + zz), turn[5] = yz - wx;
    turn[6] = xz - wy, turn[7] = yz + wx, turn[8] = -(xx + yy);
    return inverse * q->gain;
}

// Searches some lanes from q on: R - I times `factor`, and tr((R - I)^T S).
static __attribute__((noinline)) void NAME(search_lanes)(const VEC s[9], const MASK *lost,
                                                         const NAME(quaternion) * start,
                                                         REAL factor, VEC turn[9], VEC *gain) {
    VEC scaled[9], r[9], squares = {0}, found = {0};
    for (size_t k = 0; k < 9; ++k) {
        squares += s[k] * s[k];
    }
    for (size_t k = 0; k < 9; ++k) {
        scaled[k] = s[k] * NAME(inverse_root)(squares);
    }
    const VEC zero = {0}, one = zero + (REAL)1;
    const MASK usable = start->whole > (REAL)1e-10 * (squares * squares * squares);
    const VEC inverse = one / ROOT(SELECT(usable, start->whole, one));
    VEC q[4] = {SELECT(usable, start->w * inverse, one), SELECT(usable, start->x * inverse, zero),
                SELECT(usable, start->y * inverse, zero), SELECT(usable, start->z * inverse, zero)};
    NAME(search_rotation)(scaled, *lost, q, r);
    for (size_t k = 0; k < 9; ++k) {
        turn[k] = SELECT(*lost, factor * r[k], turn[k]);
        found += r[k] * s[k];
    }
    *gain = SELECT(*lost, found, *gain);
}

// Finds the failed lanes again, with R as a rotation R' after none or a half turn D about an axis;
// R' is that of S D, D such that R' turns least. Those that fail again are searched for.
static __attribute__((noinline)) void NAME(find_again)(const NAME(fit) * f, const MASK *failed,
                                                       REAL factor, VEC turn[9], VEC *gain) {
    const VEC *s = f->s;
    const MASK x = s[4] + s[8] < 0, y = s[8] + s[0] < 0, z = s[0] + s[4] < 0; // better than none
    const MASK xy = s[0] > s[4], yz = s[4] > s[8], zx = s[8] > s[0];
    const MASK some = x | y | z, about_x = some & xy & ~zx, about_y = some & yz & ~xy;
    const MASK about_z = some & ~about_x & ~about_y;
    const VEC one = (VEC){0} + (REAL)1;
    const VEC d[3] = {SELECT(about_y | about_z, -one, one), SELECT(about_z | about_x, -one, one),
                      SELECT(about_x | about_y, -one, one)};
    VEC half_turned[9] = {{0}}, found[9];
    for (size_t k = 0; k < 9; ++k) {
        half_turned[k] = s[k] * d[k % 3];
    }
    NAME(quaternion) q;
    MASK lost = f->running | NAME(quaternion_by_root)(half_turned, f->most, &q);
    VEC found_gain = NAME(matrix)(&q, factor, found);
    lost &= *failed;
    if (ANY(lost)) {
        NAME(search_lanes)(half_turned, &lost, &q, factor, found, &found_gain);
    }
    for (size_t k = 0; k < 9; ++k) {
        found[k] *= d[k % 3];
        if (k % 4 == 0) {
            found[k] += factor * (d[k / 4] - (REAL)1);
            found_gain += half_turned[k] - s[k];
        }
        turn[k] = SELECT(*failed, found[k], turn[k]);
    }
    *gain = SELECT(*failed, found_gain, *gain);
}

// `factor` times R - I. Returns tr((R - I)^T S).
static inline __attribute__((always_inline)) VEC NAME(end_fit)(NAME(fit) * f, REAL factor,
                                                               VEC turn[9]) {
    for (size_t step = 0; ANY(f->running) && step < 6; ++step) {
        const VEC most = f->most;
        NAME(value_at_most)(f);
        const MASK far = NAME(end_root)(f);
        f->most = SELECT(f->running, f->most, most);
        f->running &= far;
    }
    NAME(quaternion) q;
    const MASK failed = f->running | NAME(quaternion_by_root)(f->s, f->most, &q);
    VEC gain = NAME(matrix)(&q, factor, turn);
    if (ANY(failed)) {
        VEC found[9], found_gain = gain; // copies, so that these may stay in registers
        memcpy(found, turn, sizeof(found));
        NAME(find_again)(f, &failed, factor, found, &found_gain);
        memcpy(turn, found, sizeof(found));
        gain = found_gain;
    }
    return gain;
}

// Displacements u of the vertices; `columns` is that of the data, known where this is compiled.
static inline __attribute__((always_inline)) void
NAME(displace)(const pci_skin_data *data, const pci_skin_patch *patch, const REAL *driver,
               const size_t columns, REAL *displacements) {
    const REAL *points = data->points;
    for (size_t v = 0; v < patch->local_count; ++v) {
        const uint32_t *bones = &data->bones[(size_t)patch->vertices[v] * data->slots];
        const double *weights = &data->weights[(size_t)patch->vertices[v] * data->slots];
        const REAL *point = &points[pci_skin_point_at(patch->vertices[v], columns)];
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            VEC map[12] = {{0}};
            for (size_t k = 0; k < data->slots; ++k) {
                const REAL *d = &driver[3 * PCI_BLOCK * columns * bones[k] + lane];
                const VEC weight = NAME(all)((REAL)weights[k]);
                for (size_t c = 0; c < 3 * columns; ++c) {
                    map[c] = FUSED(map[c], weight, LOAD(d + c * PCI_BLOCK));
                }
            }
            REAL *u = &displacements[3 * PCI_BLOCK * v + lane];
            for (size_t c = 0; c < 3; ++c) {
                for (size_t k = 1; k < columns; ++k) {
                    map[c] = FUSED(map[c], NAME(all)(point[k]), map[3 * k + c]);
                }
                STORE(u + c * PCI_BLOCK, map[c]);
            }
        }
    }
}

// One lane group of one vertex.
typedef struct NAME(vertex) {
    const pci_skin_runs *runs;
    const REAL *constants, *lengths;
    VEC u[3], attached[3], squares[2]; // the last: sums of s |x|^2, if asked for
    NAME(fit) fits[2];                 // of L_r and L_c
    VEC turns[2][9];                   // I - R times the scale of the gradient
} NAME(vertex);

// Adds sum x e^T over some edges to s, sum Kw x to `attached`, and sum |x|^2 to `squares`, with the
// edges' stiffness in the first and last (these two may be NULL). `displacements` from the lane on.
static inline __attribute__((always_inline)) void
NAME(gather)(const pci_skin_patch *patch, const REAL *displacements, uint32_t begin, uint32_t end,
             const VEC u[3], VEC s[9], VEC attached[3], VEC *squares) {
    const REAL *e = patch->vectors, *weights = patch->near_weights, *stiffness = patch->stiffness;
    for (size_t k = begin; k < end; ++k) {
        const REAL *uj = &displacements[3 * PCI_BLOCK * (size_t)patch->targets[k]];
        const VEC x = u[0] - LOAD(uj), y = u[1] - LOAD(uj + PCI_BLOCK);
        const VEC z = u[2] - LOAD(uj + 2 * PCI_BLOCK);
        const VEC ex = NAME(all)(e[3 * k]), ey = NAME(all)(e[3 * k + 1]);
        const VEC ez = NAME(all)(e[3 * k + 2]);
        s[0] = FUSED(s[0], x, ex), s[1] = FUSED(s[1], x, ey), s[2] = FUSED(s[2], x, ez);
        s[3] = FUSED(s[3], y, ex), s[4] = FUSED(s[4], y, ey), s[5] = FUSED(s[5], y, ez);
        s[6] = FUSED(s[6], z, ex), s[7] = FUSED(s[7], z, ey), s[8] = FUSED(s[8], z, ez);
        if (attached != NULL) {
            const VEC weight = NAME(all)(weights[k]);
            attached[0] = FUSED(attached[0], weight, x);
            attached[1] = FUSED(attached[1], weight, y);
            attached[2] = FUSED(attached[2], weight, z);
        }
        if (squares != NULL) {
            const VEC square = FUSED(FUSED(x * x, y, y), z, z);
            *squares = FUSED(*squares, NAME(all)(stiffness[k]), square);
        }
    }
}

// from + a symmetric matrix of 6 entries
static inline __attribute__((always_inline)) void
NAME(add_symmetric)(const VEC from[9], const REAL *entries, VEC sum[9]) {
    sum[0] = from[0] + entries[0], sum[1] = from[1] + entries[1], sum[2] = from[2] + entries[2];
    sum[3] = from[3] + entries[1], sum[4] = from[4] + entries[3], sum[5] = from[5] + entries[4];
    sum[6] = from[6] + entries[2], sum[7] = from[7] + entries[4], sum[8] = from[8] + entries[5];
}

// Of both terms: S, L_a's a; and, if asked for, sums of |x|^2.
static inline __attribute__((always_inline)) void NAME(gather_all)(const pci_skin_patch *patch,
                                                                   const REAL *displacements,
                                                                   const bool measured,
                                                                   NAME(vertex) * v) {
    const pci_skin_runs *runs = v->runs;
    const VEC u[3] = {v->u[0], v->u[1], v->u[2]};
    VEC both[9] = {{0}}, s[9], shared = {0}, squares = {0};
    VEC attached[3] = {NAME(all)(v->constants[PCI_SKIN_ATTACHED]),
                       NAME(all)(v->constants[PCI_SKIN_ATTACHED + 1]),
                       NAME(all)(v->constants[PCI_SKIN_ATTACHED + 2])};
    NAME(gather)
    (patch, displacements, runs->near, runs->ring_end, u, both, attached,
     measured ? &shared : NULL);
    NAME(add_symmetric)(both, &v->constants[PCI_SKIN_NEAR], s);
    NAME(gather)
    (patch, displacements, runs->ring_end, runs->end, u, s, attached, measured ? &squares : NULL);
    memcpy(v->fits[1].s, s, sizeof(s));
    memcpy(v->attached, attached, sizeof(attached));
    v->squares[1] = shared + squares;
    NAME(add_symmetric)(both, &v->constants[PCI_SKIN_RING], s);
    squares = shared;
    NAME(gather)
    (patch, displacements, runs->begin, runs->near, u, s, NULL, measured ? &squares : NULL);
    memcpy(v->fits[0].s, s, sizeof(s));
    v->squares[0] = squares;
}

// Pulls both ends of some edges: t = s (`share` x + Q e) + Kw a is added to `own` and taken from
// the forces. These and the displacements are given from the lane on.
static inline __attribute__((always_inline)) void
NAME(pull)(const pci_skin_patch *patch, const REAL *displacements, uint32_t begin, uint32_t end,
           REAL share, const VEC u[3], const VEC q[9], const VEC *a, REAL *forces, VEC own[3]) {
    const REAL *e = patch->vectors, *weights = patch->near_weights, *stiffness = patch->stiffness;
    const uint32_t *targets = patch->targets;
    for (size_t k = begin; k < end; ++k) {
        const size_t at = 3 * PCI_BLOCK * (size_t)targets[k];
        const REAL *uj = &displacements[at];
        REAL *force = &forces[at];
        const VEC pulled = NAME(all)(share * stiffness[k]);
        const VEC ex = NAME(all)(e[3 * k]), ey = NAME(all)(e[3 * k + 1]);
        const VEC ez = NAME(all)(e[3 * k + 2]);
        VEC x = pulled * (u[0] - LOAD(uj)), y = pulled * (u[1] - LOAD(uj + PCI_BLOCK));
        VEC z = pulled * (u[2] - LOAD(uj + 2 * PCI_BLOCK));
        x = FUSED(FUSED(FUSED(x, q[0], ex), q[1], ey), q[2], ez);
        y = FUSED(FUSED(FUSED(y, q[3], ex), q[4], ey), q[5], ez);
        z = FUSED(FUSED(FUSED(z, q[6], ex), q[7], ey), q[8], ez);
        if (a != NULL) {
            const VEC weight = NAME(all)(weights[k]);
            x = FUSED(x, weight, a[0]), y = FUSED(y, weight, a[1]), z = FUSED(z, weight, a[2]);
        }
        own[0] += x, own[1] += y, own[2] += z;
        STORE(force, LOAD(force) - x);
        STORE(force + PCI_BLOCK, LOAD(force + PCI_BLOCK) - y);
        STORE(force + 2 * PCI_BLOCK, LOAD(force + 2 * PCI_BLOCK) - z);
    }
}

// The same for L_s.
static inline __attribute__((always_inline)) void NAME(stretch)(const pci_skin_patch *patch,
                                                                const REAL *displacements,
                                                                const NAME(vertex) * v, REAL share,
                                                                REAL *forces, VEC own[3]) {
    const REAL *e = patch->vectors, *stiffness = patch->stiffness;
    for (size_t k = v->runs->upper; k < v->runs->upper_end; ++k) {
        const size_t at = 3 * PCI_BLOCK * (size_t)patch->targets[k];
        const REAL *uj = &displacements[at];
        REAL *force = &forces[at];
        const VEC s = NAME(all)(stiffness[k]);
        const VEC x = FUSED(NAME(all)(e[3 * k]), s, v->u[0] - LOAD(uj));
        const VEC y = FUSED(NAME(all)(e[3 * k + 1]), s, v->u[1] - LOAD(uj + PCI_BLOCK));
        const VEC z = FUSED(NAME(all)(e[3 * k + 2]), s, v->u[2] - LOAD(uj + 2 * PCI_BLOCK));
        const VEC length = NAME(all)(share * v->lengths[k - v->runs->upper]);
        const VEC inverse = NAME(inverse_root)(FUSED(FUSED(x * x, y, y), z, z));
        const VEC factor = FUSED(NAME(all)(share), -length, inverse);
        const VEC t[3] = {factor * x, factor * y, factor * z};
        for (size_t c = 0; c < 3; ++c) {
            own[c] += t[c];
            STORE(force + c * PCI_BLOCK, LOAD(force + c * PCI_BLOCK) - t[c]);
        }
    }
}

// Counts the lanes with det(S) < 0. `scale`: that brings S to about 1.
static inline __attribute__((always_inline)) void NAME(count_reflections)(VEC det_2, REAL scale,
                                                                          uint64_t *counts) {
    const VEC relative = (REAL)0.5 * scale * scale * scale * det_2;
    for (size_t l = 0; l < LANES; ++l) {
        counts[l] += relative[l] < (REAL)-CURVATURE_TOLERANCE;
    }
}

// Finds the rotations of both terms. `sums`: NULL or added to.
static inline __attribute__((always_inline)) void
NAME(fit_rotations)(NAME(vertex) * v, size_t lane, const double scale[4], pci_skin_sums *sums) {
    for (size_t x = 0; x < 2; ++x) {
        const VEC gain = NAME(end_fit)(&v->fits[x], (REAL)-scale[x], v->turns[x]);
        if (sums != NULL) {
            const VEC loss = v->squares[x] - (gain + gain);
            for (size_t l = 0; l < LANES; ++l) {
                sums->losses[x][lane + l] += (double)loss[l];
            }
        }
    }
    if (sums != NULL) {
        const VEC loss = NAME(dot)(v->attached, v->attached);
        for (size_t l = 0; l < LANES; ++l) {
            sums->losses[2][lane + l] += (double)loss[l];
        }
        NAME(count_reflections)
        (v->fits[0].det_2, v->constants[PCI_SKIN_RING + 6], &sums->reflections[lane]);
    }
}

// Adds half of dE/du that the terms of one vertex cause.
static inline __attribute__((always_inline)) void
NAME(add_forces)(const pci_skin_patch *patch, const REAL *displacements, const NAME(vertex) * v,
                 const double scale[4], REAL *forces, REAL *own_force) {
    const pci_skin_runs *runs = v->runs;
    const REAL rigid = (REAL)scale[0], collision = (REAL)scale[1], attachment = (REAL)scale[2];
    const VEC *ring = v->turns[0], *near = v->turns[1];
    const VEC both[9] = {ring[0] + near[0], ring[1] + near[1], ring[2] + near[2],
                         ring[3] + near[3], ring[4] + near[4], ring[5] + near[5],
                         ring[6] + near[6], ring[7] + near[7], ring[8] + near[8]};
    const VEC a[3] = {attachment * v->attached[0], attachment * v->attached[1],
                      attachment * v->attached[2]};
    VEC own[3] = {LOAD(own_force), LOAD(own_force + PCI_BLOCK), LOAD(own_force + 2 * PCI_BLOCK)};
    NAME(pull)
    (patch, displacements, runs->begin, runs->near, rigid, v->u, ring, NULL, forces, own);
    NAME(pull)
    (patch, displacements, runs->near, runs->ring_end, rigid + collision, v->u, both, a, forces,
     own);
    NAME(pull)
    (patch, displacements, runs->ring_end, runs->end, collision, v->u, near, a, forces, own);
    if (scale[3] != 0.0) {
        NAME(stretch)(patch, displacements, v, (REAL)(2.0 * scale[3]), forces, own);
    }
    STORE(own_force, own[0]);
    STORE(own_force + PCI_BLOCK, own[1]);
    STORE(own_force + 2 * PCI_BLOCK, own[2]);
}

// Sums of four arrays over the frames, by halves in a fixed tree.
static inline __attribute__((always_inline)) void NAME(add_lanes)(const VEC *products, QUAD *sum) {
#if LANES == 16 // without a way through memory
#define HALVES(a, b, at, step)                                                                     \
    __builtin_shufflevector(a, b, at, at + 1, at + 2, at + 3, at + step, at + step + 1,            \
                            at + step + 2, at + step + 3, at + 16, at + 17, at + 18, at + 19,      \
                            at + 16 + step, at + 17 + step, at + 18 + step, at + 19 + step)
    const VEC first =
        HALVES(products[0], products[1], 0, 4) + HALVES(products[0], products[1], 8, 4);
    const VEC second =
        HALVES(products[2], products[3], 0, 4) + HALVES(products[2], products[3], 8, 4);
    const VEC fours = HALVES(first, second, 0, 8) + HALVES(first, second, 4, 8);
#undef HALVES
    const VEC twos = fours + __builtin_shufflevector(fours, fours, 2, 3, 0, 1, 6, 7, 4, 5, 10, 11,
                                                     8, 9, 14, 15, 12, 13);
    const VEC ones = twos + __builtin_shufflevector(twos, twos, 1, 0, 3, 2, 5, 4, 7, 6, 9, 8, 11,
                                                    10, 13, 12, 15, 14);
    *sum = __builtin_shufflevector(ones, ones, 0, 4, 8, 12);
#else
    QUAD sums[4];
    for (size_t k = 0; k < 4; ++k) {
        const QUAD *p = (const QUAD *)(const void *)&products[k * PCI_BLOCK / LANES];
        sums[k] = (p[0] + p[2]) + (p[1] + p[3]);
    }
    const QUAD low = __builtin_shufflevector(sums[0], sums[1], 0, 4, 1, 5);
    const QUAD low_half = __builtin_shufflevector(sums[0], sums[1], 2, 6, 3, 7);
    const QUAD high = __builtin_shufflevector(sums[2], sums[3], 0, 4, 1, 5);
    const QUAD high_half = __builtin_shufflevector(sums[2], sums[3], 2, 6, 3, 7);
    const QUAD first = low + low_half, second = high + high_half;
    *sum = __builtin_shufflevector(first, second, 0, 1, 4, 5) +
           __builtin_shufflevector(first, second, 2, 3, 6, 7);
#endif
}

// One coordinate of what a bone does to a point.
static inline __attribute__((always_inline)) VEC NAME(apply)(const REAL *d, const REAL *point,
                                                             const size_t columns) {
    VEC moved = LOAD(d);
    for (size_t k = 1; k < columns; ++k) {
        moved = FUSED(moved, NAME(all)(point[k]), LOAD(d + 3 * PCI_BLOCK * k));
    }
    return moved;
}

// dL/dw_ij = sum over frames of dL/du . A_j x_i for some bones; `count`, at most 4, and `columns`
// known where this is compiled.
static inline __attribute__((always_inline)) void
NAME(collect_bones)(const REAL *driver, const size_t columns, const REAL *point,
                    const uint32_t *bones, const size_t count, const REAL *g, REAL *gradient) {
    VEC products[4 * PCI_BLOCK / LANES] = {{0}};
    for (size_t k = 0; k < count; ++k) {
        const REAL *d = &driver[3 * PCI_BLOCK * columns * bones[k]];
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            const VEC x = NAME(apply)(d + lane, point, columns);
            const VEC y = NAME(apply)(d + lane + PCI_BLOCK, point, columns);
            const VEC z = NAME(apply)(d + lane + 2 * PCI_BLOCK, point, columns);
            const VEC gx = LOAD(&g[lane]), gy = LOAD(&g[PCI_BLOCK + lane]);
            const VEC gz = LOAD(&g[2 * PCI_BLOCK + lane]);
            products[(k * PCI_BLOCK + lane) / LANES] = FUSED(FUSED(gx * x, gy, y), gz, z);
        }
    }
    QUAD sums;
    NAME(add_lanes)(products, &sums);
    QUAD row = {0};
    memcpy(&row, gradient, count * sizeof(*gradient));
    row += sums + sums;
    memcpy(gradient, &row, count * sizeof(*gradient));
}

static inline __attribute__((always_inline)) void
NAME(collect)(const pci_skin_data *data, const pci_skin_patch *patch, const REAL *driver,
              const size_t columns, const REAL *forces, REAL *gradient) {
    const REAL *points = data->points;
    for (size_t v = 0; v < patch->local_count; ++v) {
        const uint32_t *bones = &data->bones[(size_t)patch->vertices[v] * data->slots];
        const REAL *point = &points[pci_skin_point_at(patch->vertices[v], columns)];
        const REAL *g = &forces[3 * PCI_BLOCK * v];
        REAL *row = &gradient[v * data->slots];
        size_t k = 0;
        for (; k + 4 <= data->slots; k += 4) {
            NAME(collect_bones)(driver, columns, point, &bones[k], 4, g, &row[k]);
        }
        for (; k < data->slots; ++k) {
            NAME(collect_bones)(driver, columns, point, &bones[k], 1, g, &row[k]);
        }
    }
}

// Some vertices at a time: the search for a root is a long chain of operations that wait for one
// another.
static inline __attribute__((always_inline)) void
NAME(evaluate_batch)(const pci_skin_data *data, const pci_skin_patch *patch, size_t begin,
                     size_t end, size_t lane, const REAL *lengths, const REAL *displacements,
                     REAL *forces, pci_skin_sums *sums) {
    NAME(vertex) batch[PCI_SKIN_BATCH];
    for (size_t i = begin; i < end; ++i) {
        NAME(vertex) *v = &batch[i - begin];
        const REAL *u = &displacements[3 * PCI_BLOCK * i];
        v->runs = &patch->runs[i];
        v->constants = (const REAL *)patch->constants + PCI_SKIN_CONSTANTS * i;
        v->lengths = lengths;
        lengths += v->runs->upper_end - v->runs->upper;
        v->u[0] = LOAD(u), v->u[1] = LOAD(u + PCI_BLOCK), v->u[2] = LOAD(u + 2 * PCI_BLOCK);
        if (sums != NULL) {
            NAME(gather_all)(patch, displacements, true, v);
        } else {
            NAME(gather_all)(patch, displacements, false, v);
        }
        NAME(begin_fit)(&v->fits[0]);
        NAME(begin_fit)(&v->fits[1]);
    }
    for (size_t k = 0; k < 2 * (end - begin); ++k) {
        NAME(step_root)(&batch[k / 2].fits[k % 2]);
    }
    // Few lanes need more.
    for (size_t k = 0; k < 2 * (end - begin); ++k) {
        batch[k / 2].fits[k % 2].running = NAME(end_root)(&batch[k / 2].fits[k % 2]);
    }
    for (size_t i = 0; i < end - begin; ++i) {
        NAME(fit_rotations)(&batch[i], lane, data->scale, sums);
        if (forces != NULL) {
            NAME(add_forces)
            (patch, displacements, &batch[i], data->scale, forces,
             &forces[3 * PCI_BLOCK * (begin + i)]);
        }
    }
}

static void NAME(evaluate)(const pci_skin_data *data, const pci_skin_patch *patch,
                           const void *driver, const pci_skin_buffers *buffers, pci_skin_sums *sums,
                           void *gradient) {
    REAL *displacements = buffers->displacements, *forces = buffers->forces;
    if (data->columns == 1) {
        NAME(displace)(data, patch, driver, 1, displacements);
    } else {
        NAME(displace)(data, patch, driver, 4, displacements);
    }
    if (gradient != NULL) {
        memset(forces, 0, 3 * PCI_BLOCK * patch->local_count * sizeof(*forces));
    }
    const REAL *lengths = patch->lengths;
    for (size_t begin = 0; begin < patch->own_count; begin += PCI_SKIN_BATCH) {
        const size_t left = patch->own_count - begin;
        const size_t end = begin + (left < PCI_SKIN_BATCH ? left : PCI_SKIN_BATCH);
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            NAME(evaluate_batch)
            (data, patch, begin, end, lane, lengths, &displacements[lane],
             gradient != NULL ? &forces[lane] : NULL, sums);
        }
        for (size_t i = begin; i < end; ++i) {
            lengths += patch->runs[i].upper_end - patch->runs[i].upper;
        }
    }
    if (gradient != NULL && data->columns == 1) {
        NAME(collect)(data, patch, driver, 1, forces, gradient);
    } else if (gradient != NULL) {
        NAME(collect)(data, patch, driver, 4, forces, gradient);
    }
}

const pci_skin_kernel NAME(pci_skin) = {
    .real_size = sizeof(REAL), .multiply_rows = ROWS, .evaluate = NAME(evaluate)};

#undef VEC
#undef QUAD
#undef MASK
#undef LOAD
#undef STORE
#undef SELECT
#undef REAL
#undef INTEGER
#undef LANES
#undef ANY
#undef NAME
#undef ROOT
#undef EACH_ROOT
#undef FUSED
#undef EACH_FMA
#undef LENGTH_TOLERANCE
#undef STEP_TOLERANCE
#undef CURVATURE_TOLERANCE
#undef ROOT_TOLERANCE
