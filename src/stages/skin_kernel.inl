// Kernels for one real type and one instruction set; included by skin_kernel_*.c with
//   REAL     float or double
//   INTEGER  integer of the same size
//   LANES    frames per register, divides PCI_BLOCK
//   ANY(mask)  whether any bit is set
//   NAME(x)  name of x for this type
//   ROWS     what skin_rows.inl made for this instruction set
//   ROOT_BITS, ROOT_STEPS, LENGTH_TOLERANCE  see NAME(inverse_root)
//   STEP_TOLERANCE, CURVATURE_TOLERANCE  see NAME(fit_rotation)
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

// The rotation R = I + r that maximises tr(R^T S), in place of the first guess q, a unit
// quaternion.
//
// Newton's method on R exp([w]). With P = R^T S the gradient is g = axial(P - P^T) and minus the
// Hessian is H = tr(P) I - sym(P). Turning a stationary R by an angle a about n changes the
// objective by -(1 - cos a) n^T H n exactly, so H >= 0 certifies the global optimum; and for want
// of a third derivative there, the error after a step is of the order of its third power. Where H
// is not definite it is made so for one step uphill. Lanes that end on a saddle or do not converge
// are solved by Jacobi rotations. S is scaled to about 1.
static inline __attribute__((always_inline)) void NAME(fit_rotation)(const VEC s[9], VEC q[4],
                                                                     VEC r[9]) {
    MASK running = (MASK){0} == 0, failed = (MASK){0};
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

// Displacements u of the vertices; `columns` is that of the data, known where this is compiled.
static inline __attribute__((always_inline)) void NAME(displace)(const pci_skin_data *data,
                                                                 const pci_skin_patch *patch,
                                                                 const REAL *driver,
                                                                 const size_t columns,
                                                                 REAL *displacements) {
    const REAL *weights = data->weights, *points = data->points;
    for (size_t v = 0; v < patch->local_count; ++v) {
        const uint32_t *bones = &data->bones[(size_t)patch->vertices[v] * data->slots];
        const REAL *weight = &weights[(size_t)patch->vertices[v] * data->slots];
        const REAL *point = &points[(size_t)patch->vertices[v] * columns];
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            VEC map[12] = {{0}};
            for (size_t k = 0; k < data->slots; ++k) {
                const REAL *d = &driver[3 * PCI_BLOCK * columns * bones[k] + lane];
                for (size_t c = 0; c < 3 * columns; ++c) {
                    map[c] += weight[k] * LOAD(d + c * PCI_BLOCK);
                }
            }
            REAL *u = &displacements[3 * PCI_BLOCK * v + lane];
            for (size_t c = 0; c < 3; ++c) {
                for (size_t k = 1; k < columns; ++k) {
                    map[c] += point[k] * map[3 * k + c];
                }
                STORE(u + c * PCI_BLOCK, map[c]);
            }
        }
    }
}

// One lane group of one vertex.
typedef struct NAME(vertex) {
    const pci_skin_patch *patch;
    const pci_skin_runs *runs;
    const REAL *constants, *displacements; // the latter from the lane on
    VEC u[3];
} NAME(vertex);

// Adds sum x e^T over some edges to s, sum Kw x to `attached`, and sum |x|^2 to `squares`, with the
// edges' stiffness in the first and last (these
// two may be NULL).
static inline __attribute__((always_inline)) void NAME(gather)(const NAME(vertex) * v,
                                                               uint32_t begin, uint32_t end,
                                                               VEC s[9], VEC attached[3],
                                                               VEC *squares) {
    const REAL *e = v->patch->vectors, *weights = v->patch->near_weights;
    const REAL *stiffness = v->patch->stiffness;
    for (size_t k = begin; k < end; ++k) {
        const REAL *uj = &v->displacements[3 * PCI_BLOCK * (size_t)v->patch->targets[k]];
        const VEC x = v->u[0] - LOAD(uj), y = v->u[1] - LOAD(uj + PCI_BLOCK);
        const VEC z = v->u[2] - LOAD(uj + 2 * PCI_BLOCK);
        const REAL ex = e[3 * k], ey = e[3 * k + 1], ez = e[3 * k + 2];
        s[0] += x * ex, s[1] += x * ey, s[2] += x * ez;
        s[3] += y * ex, s[4] += y * ey, s[5] += y * ez;
        s[6] += z * ex, s[7] += z * ey, s[8] += z * ez;
        if (attached != NULL) {
            attached[0] += weights[k] * x, attached[1] += weights[k] * y;
            attached[2] += weights[k] * z;
        }
        if (squares != NULL) {
            *squares += stiffness[k] * (x * x + y * y + z * z);
        }
    }
}

// Of both terms: S scaled to about 1, L_a's a; and, if asked for, sums of |x|^2.
static inline __attribute__((always_inline)) void NAME(gather_all)(const NAME(vertex) * v,
                                                                   VEC ring[9], VEC near[9],
                                                                   VEC attached[3],
                                                                   VEC squares[2]) {
    static const uint8_t entry[9] = {0, 1, 2, 1, 3, 4, 2, 4, 5};
    const pci_skin_runs *runs = v->runs;
    VEC both[9] = {{0}}, shared = {0};
    for (size_t k = 0; k < 9; ++k) {
        ring[k] = near[k] = (VEC){0};
    }
    for (size_t k = 0; k < 3; ++k) {
        attached[k] = (VEC){0} + v->constants[PCI_SKIN_ATTACHED + k];
    }
    if (squares != NULL) {
        squares[0] = squares[1] = (VEC){0};
    }
    NAME(gather)(v, runs->begin, runs->near, ring, NULL, squares);
    NAME(gather)
    (v, runs->near, runs->ring_end, both, attached, squares != NULL ? &shared : NULL);
    NAME(gather)
    (v, runs->ring_end, runs->end, near, attached, squares != NULL ? &squares[1] : NULL);
    for (size_t k = 0; k < 9; ++k) {
        ring[k] += both[k] + v->constants[PCI_SKIN_RING + entry[k]];
        near[k] += both[k] + v->constants[PCI_SKIN_NEAR + entry[k]];
        ring[k] *= v->constants[PCI_SKIN_RING + 6];
        near[k] *= v->constants[PCI_SKIN_NEAR + 6];
    }
    if (squares != NULL) {
        squares[0] += shared;
        squares[1] += shared;
    }
}

// Sum of squared residuals: sum |x|^2 - 2 tr((R - I)^T S).
static inline __attribute__((always_inline)) VEC NAME(loss)(const VEC s[9], const VEC r[9],
                                                            VEC squares, REAL scale) {
    VEC sum = {0};
    for (size_t k = 0; k < 9; ++k) {
        sum += r[k] * s[k];
    }
    return squares - (scale > 0 ? (REAL)2 / scale : 0) * sum;
}

// Pulls both ends of some edges: t = s (`share` x - Q e) + Kw a is added to `own` and taken from
// the forces (from the lane on).
static inline __attribute__((always_inline)) void NAME(pull)(const NAME(vertex) * v, uint32_t begin,
                                                             uint32_t end, REAL share,
                                                             const VEC q[9], const VEC *a,
                                                             REAL *forces, VEC own[3]) {
    const REAL *e = v->patch->vectors, *weights = v->patch->near_weights;
    const REAL *stiffness = v->patch->stiffness;
    for (size_t k = begin; k < end; ++k) {
        const size_t at = 3 * PCI_BLOCK * (size_t)v->patch->targets[k];
        const REAL *uj = &v->displacements[at];
        REAL *force = &forces[at];
        const REAL ex = e[3 * k], ey = e[3 * k + 1], ez = e[3 * k + 2];
        VEC t[3];
        for (size_t c = 0; c < 3; ++c) {
            t[c] = share * stiffness[k] * (v->u[c] - LOAD(uj + c * PCI_BLOCK)) -
                   (q[3 * c] * ex + q[3 * c + 1] * ey + q[3 * c + 2] * ez);
            if (a != NULL) {
                t[c] += weights[k] * a[c];
            }
            own[c] += t[c];
            STORE(force + c * PCI_BLOCK, LOAD(force + c * PCI_BLOCK) - t[c]);
        }
    }
}

// 1 / sqrt(x + LENGTH_TOLERANCE) to rounding: a guess from the bits, then Newton's method. Hardware
// takes several times as long.
static inline __attribute__((always_inline)) VEC NAME(inverse_root)(VEC x) {
    x += (REAL)LENGTH_TOLERANCE;
    VEC y = (VEC)((INTEGER)ROOT_BITS - ((MASK)x >> 1));
    const VEC half = (REAL)0.5 * x;
    for (int step = 0; step < ROOT_STEPS; ++step) {
        y *= (REAL)1.5 - half * y * y;
    }
    return y;
}

// The same for L_s.
static inline __attribute__((always_inline)) void NAME(stretch)(const NAME(vertex) * v, REAL share,
                                                                REAL *forces, VEC own[3]) {
    const REAL *e = v->patch->vectors, *lengths = v->patch->lengths;
    const REAL *stiffness = v->patch->stiffness;
    for (size_t k = v->runs->upper; k < v->runs->upper_end; ++k) {
        const size_t at = 3 * PCI_BLOCK * (size_t)v->patch->targets[k];
        const REAL *uj = &v->displacements[at];
        REAL *force = &forces[at];
        const VEC x = e[3 * k] + stiffness[k] * (v->u[0] - LOAD(uj));
        const VEC y = e[3 * k + 1] + stiffness[k] * (v->u[1] - LOAD(uj + PCI_BLOCK));
        const VEC z = e[3 * k + 2] + stiffness[k] * (v->u[2] - LOAD(uj + 2 * PCI_BLOCK));
        const VEC factor = share - share * lengths[k] * NAME(inverse_root)(x * x + y * y + z * z);
        const VEC t[3] = {factor * x, factor * y, factor * z};
        for (size_t c = 0; c < 3; ++c) {
            own[c] += t[c];
            STORE(force + c * PCI_BLOCK, LOAD(force + c * PCI_BLOCK) - t[c]);
        }
    }
}

// Counts the lanes with det(S) < 0.
static inline __attribute__((always_inline)) void NAME(count_reflections)(const VEC s[9],
                                                                          uint64_t *counts) {
    const VEC det = s[0] * (s[4] * s[8] - s[5] * s[7]) - s[1] * (s[3] * s[8] - s[5] * s[6]) +
                    s[2] * (s[3] * s[7] - s[4] * s[6]);
    for (size_t l = 0; l < LANES; ++l) {
        counts[l] += det[l] < (REAL)-CURVATURE_TOLERANCE;
    }
}

static inline __attribute__((always_inline)) void
NAME(add_sums)(const NAME(vertex) * v, size_t lane, const VEC ring[9], const VEC near[9],
               const VEC ring_turn[9], const VEC near_turn[9], const VEC attached[3],
               const VEC squares[2], pci_skin_sums *sums) {
    const VEC losses[3] = {NAME(loss)(ring, ring_turn, squares[0], v->constants[PCI_SKIN_RING + 6]),
                           NAME(loss)(near, near_turn, squares[1], v->constants[PCI_SKIN_NEAR + 6]),
                           attached[0] * attached[0] + attached[1] * attached[1] +
                               attached[2] * attached[2]};
    for (size_t x = 0; x < 3; ++x) {
        for (size_t l = 0; l < LANES; ++l) {
            sums->losses[x][lane + l] += (double)losses[x][l];
        }
    }
    NAME(count_reflections)(ring, &sums->reflections[lane]);
}

// Adds half of dE/du that the terms of one vertex cause, from its rotations.
static inline __attribute__((always_inline)) void
NAME(add_forces)(const NAME(vertex) * v, const double scale[4], const VEC ring_turn[9],
                 const VEC near_turn[9], const VEC attached[3], REAL *forces, REAL *own_force) {
    const pci_skin_runs *runs = v->runs;
    const REAL rigid = (REAL)scale[0], collision = (REAL)scale[1];
    VEC ring[9], near[9], both[9], a[3], own[3];
    for (size_t k = 0; k < 9; ++k) {
        ring[k] = rigid * ring_turn[k];
        near[k] = collision * near_turn[k];
        both[k] = ring[k] + near[k];
    }
    for (size_t k = 0; k < 3; ++k) {
        a[k] = (REAL)scale[2] * attached[k];
        own[k] = LOAD(own_force + k * PCI_BLOCK);
    }
    NAME(pull)(v, runs->begin, runs->near, rigid, ring, NULL, forces, own);
    NAME(pull)(v, runs->near, runs->ring_end, rigid + collision, both, a, forces, own);
    NAME(pull)(v, runs->ring_end, runs->end, collision, near, a, forces, own);
    if (scale[3] != 0.0) {
        NAME(stretch)(v, (REAL)(2.0 * scale[3]), forces, own);
    }
    for (size_t k = 0; k < 3; ++k) {
        STORE(own_force + k * PCI_BLOCK, own[k]);
    }
}

// Sums of four arrays over the lanes, by halves in a fixed tree.
static inline __attribute__((always_inline)) void NAME(add_lanes)(const REAL *products, QUAD *sum) {
    QUAD sums[4];
    for (size_t k = 0; k < 4; ++k) {
        const QUAD *p = (const QUAD *)(const void *)&products[k * PCI_BLOCK];
        sums[k] = (p[0] + p[2]) + (p[1] + p[3]);
    }
    const QUAD low = __builtin_shufflevector(sums[0], sums[1], 0, 4, 1, 5);
    const QUAD low_half = __builtin_shufflevector(sums[0], sums[1], 2, 6, 3, 7);
    const QUAD high = __builtin_shufflevector(sums[2], sums[3], 0, 4, 1, 5);
    const QUAD high_half = __builtin_shufflevector(sums[2], sums[3], 2, 6, 3, 7);
    const QUAD first = low + low_half, second = high + high_half;
    *sum = __builtin_shufflevector(first, second, 0, 1, 4, 5) +
           __builtin_shufflevector(first, second, 2, 3, 6, 7);
}

// One coordinate of what a bone does to a point.
static inline __attribute__((always_inline)) VEC NAME(apply)(const REAL *d, const REAL *point,
                                                             const size_t columns) {
    VEC moved = LOAD(d);
    for (size_t k = 1; k < columns; ++k) {
        moved += point[k] * LOAD(d + 3 * PCI_BLOCK * k);
    }
    return moved;
}

// dL/dw_ij = sum over frames of dL/du . A_j x_i.
static inline __attribute__((always_inline)) void
NAME(collect)(const pci_skin_data *data, const pci_skin_patch *patch, const REAL *driver,
              const size_t columns, const REAL *forces, REAL *gradient) {
    REAL products[4 * PCI_BLOCK] __attribute__((aligned(64))) = {0};
    const REAL *points = data->points;
    for (size_t v = 0; v < patch->local_count; ++v) {
        const uint32_t *bones = &data->bones[(size_t)patch->vertices[v] * data->slots];
        const REAL *point = &points[(size_t)patch->vertices[v] * columns];
        const REAL *g = &forces[3 * PCI_BLOCK * v];
        for (size_t first = 0; first < data->slots; first += 4) {
            const size_t count = data->slots - first < 4 ? data->slots - first : 4;
            for (size_t k = 0; k < count; ++k) {
                const REAL *d = &driver[3 * PCI_BLOCK * columns * bones[first + k]];
                for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
                    const VEC x = NAME(apply)(d + lane, point, columns);
                    const VEC y = NAME(apply)(d + PCI_BLOCK + lane, point, columns);
                    const VEC z = NAME(apply)(d + 2 * PCI_BLOCK + lane, point, columns);
                    STORE(&products[k * PCI_BLOCK + lane],
                          LOAD(&g[lane]) * x + LOAD(&g[PCI_BLOCK + lane]) * y +
                              LOAD(&g[2 * PCI_BLOCK + lane]) * z);
                }
            }
            QUAD sums;
            NAME(add_lanes)(products, &sums);
            for (size_t k = 0; k < count; ++k) {
                gradient[v * data->slots + first + k] += (REAL)2 * sums[k];
            }
        }
    }
}

// Product of a and b, or of a and the inverse of b.
static inline __attribute__((always_inline)) void NAME(multiply)(const VEC a[4], const VEC b[4],
                                                                 bool inverse, VEC out[4]) {
    const REAL sign = inverse ? (REAL)-1 : (REAL)1;
    const VEC x = sign * b[1], y = sign * b[2], z = sign * b[3];
    out[0] = a[0] * b[0] - a[1] * x - a[2] * y - a[3] * z;
    out[1] = a[0] * x + a[1] * b[0] + a[2] * z - a[3] * y;
    out[2] = a[0] * y + a[2] * b[0] + a[3] * x - a[1] * z;
    out[3] = a[0] * z + a[3] * b[0] + a[1] * y - a[2] * x;
}

// First guess of a rotation: that of the block before, turned as the vertex before has turned since
// then; or that of the vertex before.
static inline __attribute__((always_inline)) void
NAME(guess)(const REAL *quaternion, bool has_block, bool has_vertex, const REAL *turned, VEC q[4]) {
    VEC last[4], turn[4];
    for (size_t k = 0; k < 4; ++k) {
        last[k] = turn[k] = (VEC){0} + (REAL)(k == 0);
        if (has_block) {
            last[k] = LOAD(quaternion + k * PCI_BLOCK);
        } else if (has_vertex) {
            last[k] = LOAD(quaternion + k * PCI_BLOCK - 4 * PCI_BLOCK);
        }
        if (has_block && has_vertex) {
            turn[k] = LOAD(turned + k * PCI_BLOCK);
        }
    }
    NAME(multiply)(turn, last, false, q);
}

static inline __attribute__((always_inline)) void NAME(keep)(const VEC q[4], const REAL *quaternion,
                                                             REAL *turned) {
    VEC last[4], turn[4];
    for (size_t k = 0; k < 4; ++k) {
        last[k] = LOAD(quaternion + k * PCI_BLOCK);
    }
    NAME(multiply)(q, last, true, turn);
    for (size_t k = 0; k < 4; ++k) {
        STORE(turned + k * PCI_BLOCK, turn[k]);
    }
}

static void NAME(evaluate)(const pci_skin_data *data, const pci_skin_patch *patch,
                           const void *driver, const pci_skin_buffers *buffers, bool first,
                           pci_skin_sums *sums, void *gradient) {
    REAL *displacements = buffers->displacements, *forces = buffers->forces;
    REAL *quaternions = buffers->quaternions;
    REAL turned[4 * PCI_BLOCK] __attribute__((aligned(64))); // since the block before
    if (data->columns == 1) {
        NAME(displace)(data, patch, driver, 1, displacements);
    } else {
        NAME(displace)(data, patch, driver, 4, displacements);
    }
    if (gradient != NULL) {
        memset(forces, 0, 3 * PCI_BLOCK * patch->local_count * sizeof(*forces));
    }
    for (size_t i = 0; i < patch->own_count; ++i) {
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            NAME(vertex)
            v = {.patch = patch,
                 .runs = &patch->runs[i],
                 .constants = (const REAL *)patch->constants + PCI_SKIN_CONSTANTS * i,
                 .displacements = &displacements[lane]};
            VEC ring[9], near[9], attached[3], squares[2], q[4], ring_turn[9], near_turn[9];
            for (size_t k = 0; k < 3; ++k) {
                v.u[k] = LOAD(&displacements[(3 * i + k) * PCI_BLOCK + lane]);
            }
            NAME(gather_all)(&v, ring, near, attached, sums != NULL ? squares : NULL);
            REAL *quaternion = &quaternions[4 * PCI_BLOCK * i + lane];
            NAME(guess)(quaternion, !first, i > 0, &turned[lane], q);
            NAME(fit_rotation)(ring, q, ring_turn);
            NAME(keep)(q, quaternion, &turned[lane]);
            for (size_t k = 0; k < 4; ++k) {
                STORE(quaternion + k * PCI_BLOCK, q[k]);
            }
            NAME(fit_rotation)(near, q, near_turn);
            if (sums != NULL) {
                NAME(add_sums)
                (&v, lane, ring, near, ring_turn, near_turn, attached, squares, sums);
            }
            if (gradient != NULL) {
                NAME(add_forces)
                (&v, data->scale, ring_turn, near_turn, attached, &forces[lane],
                 &forces[3 * PCI_BLOCK * i + lane]);
            }
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
#undef ROOT_BITS
#undef ROOT_STEPS
#undef LENGTH_TOLERANCE
#undef STEP_TOLERANCE
#undef CURVATURE_TOLERANCE
