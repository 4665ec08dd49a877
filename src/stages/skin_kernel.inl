// Kernels for one real type and one instruction set; included by skin_kernel_*.c with
//   REAL     float or double
//   INTEGER  integer of the same size
//   LANES    frames per register, divides PCI_BLOCK
//   ANY(mask)  whether any bit is set
//   NAME(x)  name of x for this type
//   ROWS     what skin_rows.inl made for this instruction set
//   ROOT(x)  square roots of a register, or EACH_ROOT, that of a number
//   LENGTH_TOLERANCE  see NAME(inverse_root)
//   STEP_TOLERANCE, CURVATURE_TOLERANCE  see NAME(search_rotation)
//   ROOT_TOLERANCE  see NAME(fit_rotation)
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

// Searches the failed lanes from the identity: R - I times `factor`.
static __attribute__((noinline)) void NAME(search_lanes)(const VEC s[9], const MASK *failed,
                                                         REAL factor, VEC turn[9]) {
    VEC scaled[9], q[4] = {{0}}, r[9], squares = {0};
    for (size_t k = 0; k < 9; ++k) {
        squares += s[k] * s[k];
    }
    for (size_t k = 0; k < 9; ++k) {
        scaled[k] = s[k] * NAME(inverse_root)(squares);
    }
    q[0] += (REAL)1;
    NAME(search_rotation)(scaled, *failed, q, r);
    for (size_t k = 0; k < 9; ++k) {
        turn[k] = SELECT(*failed, factor * r[k], turn[k]);
    }
}

// What tells the largest sum of singular values.
typedef struct NAME(spectrum) {
    VEC squares, minors_4, det_2; // |S|^2, 4 |cof S|^2, 2 det S
    VEC most, square, z_2, f_4;   // m, m^2, 2 z, 4 f
} NAME(spectrum);

static inline __attribute__((always_inline)) void NAME(cofactors)(const VEC s[9], VEC c[9]) {
    c[0] = s[4] * s[8] - s[5] * s[7], c[1] = s[5] * s[6] - s[3] * s[8];
    c[2] = s[3] * s[7] - s[4] * s[6], c[3] = s[2] * s[7] - s[1] * s[8];
    c[4] = s[0] * s[8] - s[2] * s[6], c[5] = s[1] * s[6] - s[0] * s[7];
    c[6] = s[1] * s[5] - s[2] * s[4], c[7] = s[2] * s[3] - s[0] * s[5];
    c[8] = s[0] * s[4] - s[1] * s[3];
}

static inline __attribute__((always_inline)) VEC NAME(product)(const VEC *x, const VEC *y) {
    return x[0] * y[0] + x[1] * y[1] + x[2] * y[2];
}

// One step of Halley's method in the lanes that run. Returns those that have to go on.
static inline __attribute__((always_inline)) MASK NAME(step_root)(NAME(spectrum) * p,
                                                                  MASK running) {
    const VEC z_4 = p->z_2 + p->z_2, k_2 = p->square - p->squares;
    const VEC change =
        p->f_4 * z_4 / (z_4 * (z_4 + z_4) - p->f_4 * (k_2 + (p->square + p->square)));
    const MASK far = ~(change * change * p->most < (REAL)ROOT_TOLERANCE * z_4);
    const VEC det_4 = p->det_2 + p->det_2;
    p->most = SELECT(running, p->most - change, p->most);
    p->square = p->most * p->most;
    const VEC k = p->square - p->squares;
    p->z_2 = k * p->most - p->det_2;
    p->f_4 = k * k - p->minors_4 - (det_4 + det_4) * p->most;
    return running & far;
}

// `factor` times R - I for the rotations R that maximise tr(R^T S).
//
// Markley, "Attitude determination using vector observations: a fast optimal matrix algorithm",
// 1993. The maximum m is the sum of the singular values, with the sign of det S on the least. With
// 2 k = m^2 - |S|^2 and z = k m - det S it is the largest root of
// f = k^2 - 2 m det S - |cof S|^2, and
//   R = ((k + |S|^2) S + m cof S - S S^T S) / z.
// All four roots are real and f' = 2 z, so a root with z > 0 is the first or the third; and
// 3 m^2 >= |S|^2 for the first, <= for the third, which tell them apart. z is the product of the
// sums of two singular values each. Where it is small R is hardly determined; such lanes, and those
// that do not converge, are searched for.
//
// Two at a time, side by side: each is a long chain of operations that wait for one another.
static inline __attribute__((always_inline)) void
NAME(fit_rotations)(VEC s[2][9], const REAL factor[2], VEC turn[2][9]) {
    VEC c[2][9], b[2][6];
    NAME(spectrum) p[2];
    MASK failed[2];
    for (size_t t = 0; t < 2; ++t) {
        NAME(cofactors)(s[t], c[t]);
    }
    for (size_t t = 0; t < 2; ++t) { // S S^T
        b[t][0] = NAME(product)(&s[t][0], &s[t][0]), b[t][1] = NAME(product)(&s[t][0], &s[t][3]);
        b[t][2] = NAME(product)(&s[t][0], &s[t][6]), b[t][3] = NAME(product)(&s[t][3], &s[t][3]);
        b[t][4] = NAME(product)(&s[t][3], &s[t][6]), b[t][5] = NAME(product)(&s[t][6], &s[t][6]);
    }
    for (size_t t = 0; t < 2; ++t) { // exact where det S = 0
        const VEC det = NAME(product)(&s[t][0], &c[t][0]);
        p[t].det_2 = det + det;
        p[t].squares = b[t][0] + b[t][3] + b[t][5];
        p[t].minors_4 =
            (REAL)4 * (NAME(product)(&c[t][0], &c[t][0]) + NAME(product)(&c[t][3], &c[t][3]) +
                       NAME(product)(&c[t][6], &c[t][6]));
    }
    for (size_t t = 0; t < 2; ++t) {
        const VEC k_2 = ROOT(p[t].minors_4), det_4 = p[t].det_2 + p[t].det_2;
        p[t].square = p[t].squares + k_2;
        p[t].most = ROOT(p[t].square);
        p[t].z_2 = k_2 * p[t].most - p[t].det_2;
        p[t].f_4 = -(det_4 + det_4) * p[t].most;
    }
    failed[0] = failed[1] = (MASK){0} == 0;
    for (int step = 0; step < 8; ++step) {
        failed[0] = NAME(step_root)(&p[0], failed[0]);
        failed[1] = NAME(step_root)(&p[1], failed[1]);
        const MASK any = failed[0] | failed[1];
        if (!ANY(any)) {
            break;
        }
    }
    for (size_t t = 0; t < 2; ++t) {
        failed[t] |= ~(p[t].z_2 > (REAL)0.02 * (p[t].square * p[t].most)) |
                     ~((REAL)3 * p[t].square > p[t].squares);
    }
    for (size_t t = 0; t < 2; ++t) {
        const VEC share = ((REAL)2 * factor[t]) / p[t].z_2, share_c = share * p[t].most;
        const VEC own = (REAL)0.5 * (p[t].squares + p[t].square);
        const VEC a[6] = {share * (own - b[t][0]), share * b[t][1], share * b[t][2],
                          share * (own - b[t][3]), share * b[t][4], share * (own - b[t][5])};
        for (size_t j = 0; j < 3; ++j) {
            const VEC x = s[t][j], y = s[t][3 + j], z = s[t][6 + j];
            turn[t][j] = (a[0] * x + share_c * c[t][j]) - (a[1] * y + a[2] * z);
            turn[t][3 + j] = (a[3] * y + share_c * c[t][3 + j]) - (a[1] * x + a[4] * z);
            turn[t][6 + j] = (a[5] * z + share_c * c[t][6 + j]) - (a[2] * x + a[4] * y);
        }
        turn[t][0] -= factor[t], turn[t][4] -= factor[t], turn[t][8] -= factor[t];
    }
    const MASK any = failed[0] | failed[1];
    if (ANY(any)) {
        for (size_t t = 0; t < 2; ++t) {
            NAME(search_lanes)(s[t], &failed[t], factor[t], turn[t]);
        }
    }
}

// Displacements u of the vertices; `columns` is that of the data, known where this is compiled.
static inline __attribute__((always_inline)) void
NAME(displace)(const pci_skin_data *data, const pci_skin_patch *patch, const REAL *driver,
               const size_t columns, REAL *displacements) {
    const REAL *points = data->points;
    for (size_t v = 0; v < patch->local_count; ++v) {
        const uint32_t *bones = &data->bones[(size_t)patch->vertices[v] * data->slots];
        const double *weights = &data->weights[(size_t)patch->vertices[v] * data->slots];
        const REAL *point = &points[(size_t)patch->vertices[v] * columns];
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            VEC map[12] = {{0}};
            for (size_t k = 0; k < data->slots; ++k) {
                const REAL *d = &driver[3 * PCI_BLOCK * columns * bones[k] + lane];
                const REAL weight = (REAL)weights[k];
                for (size_t c = 0; c < 3 * columns; ++c) {
                    map[c] += weight * LOAD(d + c * PCI_BLOCK);
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
    const REAL *constants, *lengths, *displacements; // the last from the lane on
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

// Of both terms: S, L_a's a; and, if asked for, sums of |x|^2.
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
    }
    if (squares != NULL) {
        squares[0] += shared;
        squares[1] += shared;
    }
}

// Sum of squared residuals: sum s |x|^2 - 2 tr(r^T S), r = R - I. Rounding leaves
// E = R^T R - I = r + r^T + r^T r, whose share in it is taken away: - tr(R^T S E).
static inline __attribute__((always_inline)) VEC NAME(loss)(const VEC s[9], const VEC r[9],
                                                            VEC squares) {
    VEC turned = {0}, lost = {0};
    for (size_t a = 0; a < 3; ++a) {
        for (size_t b = a; b < 3; ++b) {
            const VEC error = (r[3 * a + b] + r[3 * b + a]) +
                              (r[a] * r[b] + r[3 + a] * r[3 + b] + r[6 + a] * r[6 + b]);
            const VEC product = r[a] * s[b] + r[3 + a] * s[3 + b] + r[6 + a] * s[6 + b];
            const VEC share = (s[3 * a + b] + product) * error;
            lost += share;
            if (a == b) {
                turned += product;
            } else {
                lost += share;
            }
        }
    }
    return squares - ((turned + turned) - lost);
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

// The same for L_s.
static inline __attribute__((always_inline)) void NAME(stretch)(const NAME(vertex) * v, REAL share,
                                                                REAL *forces, VEC own[3]) {
    const REAL *e = v->patch->vectors, *stiffness = v->patch->stiffness;
    for (size_t k = v->runs->upper; k < v->runs->upper_end; ++k) {
        const size_t at = 3 * PCI_BLOCK * (size_t)v->patch->targets[k];
        const REAL *uj = &v->displacements[at];
        REAL *force = &forces[at];
        const VEC x = e[3 * k] + stiffness[k] * (v->u[0] - LOAD(uj));
        const VEC y = e[3 * k + 1] + stiffness[k] * (v->u[1] - LOAD(uj + PCI_BLOCK));
        const VEC z = e[3 * k + 2] + stiffness[k] * (v->u[2] - LOAD(uj + 2 * PCI_BLOCK));
        const REAL length = v->lengths[k - v->runs->upper];
        const VEC factor = share - share * length * NAME(inverse_root)(x * x + y * y + z * z);
        const VEC t[3] = {factor * x, factor * y, factor * z};
        for (size_t c = 0; c < 3; ++c) {
            own[c] += t[c];
            STORE(force + c * PCI_BLOCK, LOAD(force + c * PCI_BLOCK) - t[c]);
        }
    }
}

// Counts the lanes with det(S) < 0. `scale`: that brings S to about 1.
static inline __attribute__((always_inline)) void
NAME(count_reflections)(const VEC s[9], REAL scale, uint64_t *counts) {
    const VEC det = s[0] * (s[4] * s[8] - s[5] * s[7]) - s[1] * (s[3] * s[8] - s[5] * s[6]) +
                    s[2] * (s[3] * s[7] - s[4] * s[6]);
    for (size_t l = 0; l < LANES; ++l) {
        counts[l] += scale * scale * scale * det[l] < (REAL)-CURVATURE_TOLERANCE;
    }
}

static inline __attribute__((always_inline)) void
NAME(add_sums)(const NAME(vertex) * v, size_t lane, VEC s[2][9], VEC turn[2][9],
               const VEC attached[3], const VEC squares[2], pci_skin_sums *sums) {
    const VEC losses[3] = {
        NAME(loss)(s[0], turn[0], squares[0]), NAME(loss)(s[1], turn[1], squares[1]),
        attached[0] * attached[0] + attached[1] * attached[1] + attached[2] * attached[2]};
    for (size_t x = 0; x < 3; ++x) {
        for (size_t l = 0; l < LANES; ++l) {
            sums->losses[x][lane + l] += (double)losses[x][l];
        }
    }
    NAME(count_reflections)(s[0], v->constants[PCI_SKIN_RING + 6], &sums->reflections[lane]);
}

// Adds half of dE/du that the terms of one vertex cause. `ring_turn` and `near_turn`: R - I times
// the scale of the gradient.
static inline __attribute__((always_inline)) void
NAME(add_forces)(const NAME(vertex) * v, const double scale[4], const VEC ring_turn[9],
                 const VEC near_turn[9], const VEC attached[3], REAL *forces, REAL *own_force) {
    const pci_skin_runs *runs = v->runs;
    const REAL rigid = (REAL)scale[0], collision = (REAL)scale[1];
    VEC both[9], a[3], own[3];
    for (size_t k = 0; k < 9; ++k) {
        both[k] = ring_turn[k] + near_turn[k];
    }
    for (size_t k = 0; k < 3; ++k) {
        a[k] = (REAL)scale[2] * attached[k];
        own[k] = LOAD(own_force + k * PCI_BLOCK);
    }
    NAME(pull)(v, runs->begin, runs->near, rigid, ring_turn, NULL, forces, own);
    NAME(pull)(v, runs->near, runs->ring_end, rigid + collision, both, a, forces, own);
    NAME(pull)(v, runs->ring_end, runs->end, collision, near_turn, a, forces, own);
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
                    STORE(&products[k * PCI_BLOCK + lane], LOAD(&g[lane]) * x +
                                                               LOAD(&g[PCI_BLOCK + lane]) * y +
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

static void NAME(evaluate)(const pci_skin_data *data, const pci_skin_patch *patch,
                           const void *driver, const pci_skin_buffers *buffers, pci_skin_sums *sums,
                           void *gradient) {
    REAL *displacements = buffers->displacements, *forces = buffers->forces;
    const REAL factor[2] = {(REAL)data->scale[0], (REAL)data->scale[1]}, unit[2] = {1, 1};
    if (data->columns == 1) {
        NAME(displace)(data, patch, driver, 1, displacements);
    } else {
        NAME(displace)(data, patch, driver, 4, displacements);
    }
    if (gradient != NULL) {
        memset(forces, 0, 3 * PCI_BLOCK * patch->local_count * sizeof(*forces));
    }
    const REAL *lengths = patch->lengths;
    for (size_t i = 0; i < patch->own_count; ++i) {
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            NAME(vertex)
            v = {.patch = patch,
                 .runs = &patch->runs[i],
                 .constants = (const REAL *)patch->constants + PCI_SKIN_CONSTANTS * i,
                 .lengths = lengths,
                 .displacements = &displacements[lane]};
            VEC s[2][9], turn[2][9], attached[3], squares[2];
            for (size_t k = 0; k < 3; ++k) {
                v.u[k] = LOAD(&displacements[(3 * i + k) * PCI_BLOCK + lane]);
            }
            NAME(gather_all)(&v, s[0], s[1], attached, sums != NULL ? squares : NULL);
            if (sums != NULL) {
                NAME(fit_rotations)(s, unit, turn);
                NAME(add_sums)(&v, lane, s, turn, attached, squares, sums);
                for (size_t k = 0; k < 18; ++k) {
                    turn[k / 9][k % 9] *= factor[k / 9];
                }
            } else {
                NAME(fit_rotations)(s, factor, turn);
            }
            if (gradient != NULL) {
                NAME(add_forces)
                (&v, data->scale, turn[0], turn[1], attached, &forces[lane],
                 &forces[3 * PCI_BLOCK * i + lane]);
            }
        }
        lengths += patch->runs[i].upper_end - patch->runs[i].upper;
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
#undef LENGTH_TOLERANCE
#undef STEP_TOLERANCE
#undef CURVATURE_TOLERANCE
#undef ROOT_TOLERANCE
