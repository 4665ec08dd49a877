// Kernels for one real type and one instruction set; included by skin_kernel_*.c with
//   REAL     float or double
//   INTEGER  integer of the same size
//   LANES    frames per register, divides PCI_BLOCK
//   NAME(x)  name of x for this type
//   SQRT, LENGTH_TOLERANCE  square root; what keeps squared lengths from 0
//   STEP_TOLERANCE, CURVATURE_TOLERANCE  see NAME(fit_rotation)
// Vector types, loads and stores go through pointers to REAL, which are aligned to a register.

typedef REAL NAME(vec) __attribute__((vector_size(LANES * sizeof(REAL)), may_alias));
typedef INTEGER NAME(mask) __attribute__((vector_size(LANES * sizeof(REAL)), may_alias));
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

static bool NAME(any)(const MASK *mask) {
    INTEGER bits = 0;
    for (size_t l = 0; l < LANES; ++l) {
        bits |= (*mask)[l];
    }
    return bits != 0;
}

// Row-major rotation matrix of a quaternion of any length.
static inline __attribute__((always_inline)) void NAME(matrix)(const VEC q[4], VEC r[9]) {
    const VEC n = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    const VEC t = (REAL)2 / n;
    const VEC tx = t * q[1], ty = t * q[2], tz = t * q[3];
    const VEC wx = tx * q[0], wy = ty * q[0], wz = tz * q[0];
    const VEC xx = tx * q[1], xy = tx * q[2], xz = tx * q[3];
    const VEC yy = ty * q[2], yz = ty * q[3], zz = tz * q[3];
    r[0] = (REAL)1 - (yy + zz), r[1] = xy - wz, r[2] = xz + wy;
    r[3] = xy + wz, r[4] = (REAL)1 - (xx + zz), r[5] = yz - wx;
    r[6] = xz - wy, r[7] = yz + wx, r[8] = (REAL)1 - (xx + yy);
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

// The rotation R that maximises tr(R^T S), in place of the first guess q.
//
// Newton's method on R exp([w]). With P = R^T S the gradient is g = axial(P - P^T) and minus the
// Hessian is H = tr(P) I - sym(P). Turning a stationary R by an angle a about n changes the
// objective by -(1 - cos a) n^T H n exactly, so H >= 0 certifies the global optimum. Lanes that
// lose definiteness or do not converge are solved by Jacobi rotations. S is scaled to about 1.
static inline __attribute__((always_inline)) void NAME(fit_rotation)(const VEC s[9], VEC q[4],
                                                                     VEC r[9]) {
    MASK running = (MASK){0} == 0, failed = (MASK){0};
    for (int step = 0; step < 12; ++step) {
        VEC p[9];
        NAME(matrix)(q, r);
        for (size_t i = 0; i < 3; ++i) {
            for (size_t j = 0; j < 3; ++j) {
                p[3 * i + j] = r[i] * s[j] + r[3 + i] * s[3 + j] + r[6 + i] * s[6 + j];
            }
        }
        const VEC gx = p[7] - p[5], gy = p[2] - p[6], gz = p[3] - p[1];
        const VEC h00 = p[4] + p[8] + (REAL)CURVATURE_TOLERANCE;
        const VEC h11 = p[0] + p[8] + (REAL)CURVATURE_TOLERANCE;
        const VEC h22 = p[0] + p[4] + (REAL)CURVATURE_TOLERANCE;
        const VEC h01 = (REAL)-0.5 * (p[1] + p[3]);
        const VEC h02 = (REAL)-0.5 * (p[2] + p[6]);
        const VEC h12 = (REAL)-0.5 * (p[5] + p[7]);
        // Cofactors of H; its leading minors tell definiteness.
        const VEC c00 = h11 * h22 - h12 * h12, c01 = h02 * h12 - h01 * h22;
        const VEC c02 = h01 * h12 - h02 * h11, c11 = h00 * h22 - h02 * h02;
        const VEC c12 = h01 * h02 - h00 * h12, c22 = h00 * h11 - h01 * h01;
        const VEC det = h00 * c00 + h01 * c01 + h02 * c02;
        const MASK definite = (h00 > 0) & (c22 > 0) & (det > 0);
        failed |= running & ~definite;
        running &= definite;
        const VEC inverse = (REAL)1 / SELECT(definite, det, (VEC){0} + (REAL)1);
        VEC wx = inverse * (c00 * gx + c01 * gy + c02 * gz);
        VEC wy = inverse * (c01 * gx + c11 * gy + c12 * gz);
        VEC wz = inverse * (c02 * gx + c12 * gy + c22 * gz);
        // At most one radian; then q (1, w / 2), brought back to about length 1.
        const VEC length = wx * wx + wy * wy + wz * wz;
        const VEC half = (REAL)0.5 / SELECT(length > (REAL)1, length, (VEC){0} + (REAL)1);
        wx *= half, wy *= half, wz *= half;
        const VEC q0 = q[0] - q[1] * wx - q[2] * wy - q[3] * wz;
        const VEC q1 = q[1] + q[0] * wx + q[2] * wz - q[3] * wy;
        const VEC q2 = q[2] + q[0] * wy + q[3] * wx - q[1] * wz;
        const VEC q3 = q[3] + q[0] * wz + q[1] * wy - q[2] * wx;
        const VEC n = q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3;
        const VEC unit = (REAL)1.5 - (REAL)0.5 * n;
        q[0] = SELECT(running, q0 * unit, q[0]), q[1] = SELECT(running, q1 * unit, q[1]);
        q[2] = SELECT(running, q2 * unit, q[2]), q[3] = SELECT(running, q3 * unit, q[3]);
        running &= ~(length < (REAL)STEP_TOLERANCE);
        if (!NAME(any)(&running)) {
            break;
        }
    }
    failed |= running;
    if (NAME(any)(&failed)) {
        NAME(solve_lanes)(s, &failed, q);
    }
    NAME(matrix)(q, r);
}

static void NAME(displace)(const pci_skin_data *data, size_t begin, size_t end) {
    const REAL *weights = data->weights, *driver = data->driver;
    REAL *displacements = data->displacements;
    for (size_t v = begin; v < end; ++v) {
        const uint32_t *bones = &data->bones[v * data->slots];
        const REAL *weight = &weights[v * data->slots];
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            VEC x = {0}, y = {0}, z = {0};
            for (size_t k = 0; k < data->slots; ++k) {
                const REAL *d = &driver[3 * PCI_BLOCK * (size_t)bones[k] + lane];
                x += weight[k] * LOAD(d);
                y += weight[k] * LOAD(d + PCI_BLOCK);
                z += weight[k] * LOAD(d + 2 * PCI_BLOCK);
            }
            REAL *u = &displacements[3 * PCI_BLOCK * v + lane];
            STORE(u, x);
            STORE(u + PCI_BLOCK, y);
            STORE(u + 2 * PCI_BLOCK, z);
        }
    }
}

// Sum of squared residuals of one vertex, per lane.
static inline __attribute__((always_inline)) VEC NAME(loss)(const pci_skin_edges *edges,
                                                            const REAL *displacements, size_t v,
                                                            size_t lane, const VEC r[9]) {
    const REAL *e = edges->vectors;
    const REAL *u = &displacements[3 * PCI_BLOCK * v + lane];
    VEC sum = {0};
    for (size_t k = edges->offsets[v]; k < edges->offsets[v + 1]; ++k) {
        const REAL *uj = &displacements[3 * PCI_BLOCK * (size_t)edges->targets[k] + lane];
        const REAL ex = e[3 * k], ey = e[3 * k + 1], ez = e[3 * k + 2];
        const VEC x = ex + (LOAD(u) - LOAD(uj)) - (r[0] * ex + r[1] * ey + r[2] * ez);
        const VEC y =
            ey + (LOAD(u + PCI_BLOCK) - LOAD(uj + PCI_BLOCK)) - (r[3] * ex + r[4] * ey + r[5] * ez);
        const VEC z = ez + (LOAD(u + 2 * PCI_BLOCK) - LOAD(uj + 2 * PCI_BLOCK)) -
                      (r[6] * ex + r[7] * ey + r[8] * ez);
        sum += x * x + y * y + z * z;
    }
    return sum;
}

// S = sum e(t) e(0)^T of one vertex, scaled, and out = sum e(t).
static inline __attribute__((always_inline)) void NAME(covariance)(const pci_skin_edges *edges,
                                                                   const REAL *displacements,
                                                                   size_t v, size_t lane, VEC s[9],
                                                                   VEC out[3]) {
    const REAL *e = edges->vectors;
    const REAL *constant = (const REAL *)edges->constants + 13 * v;
    const REAL *u = &displacements[3 * PCI_BLOCK * v + lane];
    const VEC ux = LOAD(u), uy = LOAD(u + PCI_BLOCK), uz = LOAD(u + 2 * PCI_BLOCK);
    for (size_t k = 0; k < 9; ++k) {
        s[k] = (VEC){0} + constant[k];
    }
    for (size_t k = 0; k < 3; ++k) {
        out[k] = (VEC){0} + constant[9 + k];
    }
    for (size_t k = edges->offsets[v]; k < edges->offsets[v + 1]; ++k) {
        const REAL *uj = &displacements[3 * PCI_BLOCK * (size_t)edges->targets[k] + lane];
        const VEC x = ux - LOAD(uj), y = uy - LOAD(uj + PCI_BLOCK);
        const VEC z = uz - LOAD(uj + 2 * PCI_BLOCK);
        const REAL ex = e[3 * k], ey = e[3 * k + 1], ez = e[3 * k + 2];
        out[0] += x, out[1] += y, out[2] += z;
        s[0] += x * ex, s[1] += x * ey, s[2] += x * ez;
        s[3] += y * ex, s[4] += y * ey, s[5] += y * ez;
        s[6] += z * ex, s[7] += z * ey, s[8] += z * ez;
    }
    for (size_t k = 0; k < 9; ++k) {
        s[k] *= constant[12];
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

// On the first visit the rotations of the vertex before, if any, are a good guess.
static inline __attribute__((always_inline)) void NAME(guess_rotation)(REAL *quaternion,
                                                                       bool has_before) {
    if (quaternion[0] == 0 && quaternion[PCI_BLOCK] == 0 && quaternion[2 * PCI_BLOCK] == 0 &&
        quaternion[3 * PCI_BLOCK] == 0) {
        for (size_t k = 0; k < 8; ++k) {
            VEC guess = (VEC){0} + (REAL)(k % 4 == 0);
            if (has_before) {
                guess = LOAD(quaternion - 8 * PCI_BLOCK + k * PCI_BLOCK);
            }
            STORE(quaternion + k * PCI_BLOCK, guess);
        }
    }
}

// half of dL_s/du: 2 sum (1 - |e(0)| / |e(t)|) e(t) over the ring.
static inline __attribute__((always_inline)) void NAME(stretch)(const pci_skin_edges *edges,
                                                                const REAL *displacements, size_t v,
                                                                size_t lane, VEC sum[3]) {
    const REAL *e = edges->vectors, *lengths = edges->lengths;
    const REAL *u = &displacements[3 * PCI_BLOCK * v + lane];
    sum[0] = sum[1] = sum[2] = (VEC){0};
    for (size_t k = edges->offsets[v]; k < edges->offsets[v + 1]; ++k) {
        const REAL *uj = &displacements[3 * PCI_BLOCK * (size_t)edges->targets[k] + lane];
        const VEC x = e[3 * k] + (LOAD(u) - LOAD(uj));
        const VEC y = e[3 * k + 1] + (LOAD(u + PCI_BLOCK) - LOAD(uj + PCI_BLOCK));
        const VEC z = e[3 * k + 2] + (LOAD(u + 2 * PCI_BLOCK) - LOAD(uj + 2 * PCI_BLOCK));
        VEC length = x * x + y * y + z * z + (REAL)LENGTH_TOLERANCE;
        for (size_t l = 0; l < LANES; ++l) {
            length[l] = SQRT(length[l]);
        }
        const VEC factor = (REAL)2 - (REAL)2 * lengths[k] / length;
        sum[0] += factor * x, sum[1] += factor * y, sum[2] += factor * z;
    }
}

// The rotations of one term, out = sum e(t), and part += scale * (out - R sum e(0)).
static inline __attribute__((always_inline)) void
NAME(fit_term)(const pci_skin_data *data, const pci_skin_edges *edges, size_t v, size_t lane,
               REAL scale, REAL *quaternion, REAL *rotation, VEC part[3], VEC out[3],
               double *losses, uint64_t *reflections) {
    const REAL *displacements = data->displacements;
    const REAL *constant = (const REAL *)edges->constants + 13 * v;
    VEC s[9], q[4], r[9];
    NAME(covariance)(edges, displacements, v, lane, s, out);
    for (size_t k = 0; k < 4; ++k) {
        q[k] = LOAD(quaternion + k * PCI_BLOCK);
    }
    NAME(fit_rotation)(s, q, r);
    for (size_t k = 0; k < 4; ++k) {
        STORE(quaternion + k * PCI_BLOCK, q[k]);
    }
    for (size_t k = 0; k < 9; ++k) {
        STORE(rotation + k * PCI_BLOCK, r[k]);
    }
    const REAL bx = constant[9], by = constant[10], bz = constant[11];
    for (size_t k = 0; k < 3; ++k) {
        part[k] += scale * (out[k] - (r[3 * k] * bx + r[3 * k + 1] * by + r[3 * k + 2] * bz));
    }
    if (losses != NULL) {
        const VEC loss = NAME(loss)(edges, displacements, v, lane, r);
        for (size_t l = 0; l < LANES; ++l) {
            losses[lane + l] += (double)loss[l];
        }
    }
    if (reflections != NULL) {
        NAME(count_reflections)(s, &reflections[lane]);
    }
}

static void NAME(fit)(const pci_skin_data *data, size_t begin, size_t end, pci_skin_sums *sums) {
    const REAL *displacements = data->displacements, *near_weights = data->near_weights;
    const REAL *attachment_rest = data->attachment_rest;
    REAL *quaternions = data->quaternions, *rotations = data->rotations;
    REAL *residuals = data->residuals;
    const REAL rigid = (REAL)data->scale[0], collision = (REAL)data->scale[1];
    const REAL attachment = (REAL)data->scale[2], stretch = (REAL)data->scale[3];
    for (size_t v = begin; v < end; ++v) {
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            REAL *quaternion = &quaternions[8 * PCI_BLOCK * v + lane];
            REAL *rotation = &rotations[18 * PCI_BLOCK * v + lane];
            REAL *residual = &residuals[6 * PCI_BLOCK * v + lane];
            NAME(guess_rotation)(quaternion, v > begin);
            // Attachment: a(t) = a(0) + u_i - sum Kw_ij u_j.
            const REAL *u = &displacements[3 * PCI_BLOCK * v + lane];
            VEC a[3], part[3] = {{0}, {0}, {0}};
            for (size_t k = 0; k < 3; ++k) {
                a[k] = attachment_rest[3 * v + k] + LOAD(u + k * PCI_BLOCK);
            }
            for (size_t e = data->near.offsets[v]; e < data->near.offsets[v + 1]; ++e) {
                const REAL *uj =
                    &displacements[3 * PCI_BLOCK * (size_t)data->near.targets[e] + lane];
                a[0] -= near_weights[e] * LOAD(uj);
                a[1] -= near_weights[e] * LOAD(uj + PCI_BLOCK);
                a[2] -= near_weights[e] * LOAD(uj + 2 * PCI_BLOCK);
            }
            VEC ring[3], near[3];
            NAME(fit_term)
            (data, &data->ring, v, lane, rigid, quaternion, rotation, part, ring,
             sums != NULL ? sums->rigid : NULL, sums != NULL ? sums->reflections : NULL);
            NAME(fit_term)
            (data, &data->near, v, lane, collision, quaternion + 4 * PCI_BLOCK,
             rotation + 9 * PCI_BLOCK, part, near, sums != NULL ? sums->collision : NULL, NULL);
            // The edges j -> i add their e(t) too; in the ring those are the same edges.
            const REAL *incoming_vectors = data->incoming_vectors;
            VEC incoming[3] = {{0}, {0}, {0}};
            for (size_t e = data->incoming_offsets[v]; e < data->incoming_offsets[v + 1]; ++e) {
                const REAL *uj = &displacements[3 * PCI_BLOCK * (size_t)data->incoming[e] + lane];
                for (size_t k = 0; k < 3; ++k) {
                    incoming[k] += incoming_vectors[3 * e + k] +
                                   (LOAD(u + k * PCI_BLOCK) - LOAD(uj + k * PCI_BLOCK));
                }
            }
            if (stretch != 0) {
                VEC stretched[3];
                NAME(stretch)(&data->ring, displacements, v, lane, stretched);
                for (size_t k = 0; k < 3; ++k) {
                    part[k] += stretch * stretched[k];
                }
            }
            for (size_t k = 0; k < 3; ++k) {
                part[k] += rigid * ring[k] + collision * incoming[k] + attachment * a[k];
                STORE(residual + k * PCI_BLOCK, a[k]);
                STORE(residual + (3 + k) * PCI_BLOCK, part[k]);
            }
            if (sums != NULL) {
                const VEC loss = a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
                for (size_t l = 0; l < LANES; ++l) {
                    sums->attachment[lane + l] += (double)loss[l];
                }
            }
        }
    }
}

// S = sum e(t) e(0)^T of one vertex, scaled.
static inline __attribute__((always_inline)) void
NAME(rotation_of)(const pci_skin_edges *edges, const REAL *displacements, size_t v, size_t lane,
                  REAL *quaternion, VEC r[9], uint64_t *reflections) {
    VEC s[9], q[4], out[3];
    NAME(covariance)(edges, displacements, v, lane, s, out);
    for (size_t k = 0; k < 4; ++k) {
        q[k] = LOAD(quaternion + k * PCI_BLOCK);
    }
    NAME(fit_rotation)(s, q, r);
    for (size_t k = 0; k < 4; ++k) {
        STORE(quaternion + k * PCI_BLOCK, q[k]);
    }
    if (reflections != NULL) {
        NAME(count_reflections)(s, &reflections[lane]);
    }
}

// Half of dE/du of one term: s r_ij is added to `own` and taken from the force of j; with `stretch`
// also what L_s adds at i. Returns the sum of the squared residuals.
static inline __attribute__((always_inline)) VEC
NAME(scatter_term)(const pci_skin_edges *edges, const REAL *displacements, size_t v, size_t lane,
                   const VEC r[9], REAL scale, REAL stretch, REAL *forces, VEC own[3]) {
    const REAL *vectors = edges->vectors, *lengths = edges->lengths;
    const REAL *u = &displacements[3 * PCI_BLOCK * v + lane];
    const VEC ux = LOAD(u), uy = LOAD(u + PCI_BLOCK), uz = LOAD(u + 2 * PCI_BLOCK);
    VEC sum[3] = {{0}, {0}, {0}}, stretched[3] = {{0}, {0}, {0}}, loss = {0};
    for (size_t k = edges->offsets[v]; k < edges->offsets[v + 1]; ++k) {
        const size_t at = 3 * PCI_BLOCK * (size_t)edges->targets[k] + lane;
        const REAL *uj = &displacements[at];
        REAL *force = &forces[at];
        const REAL ex = vectors[3 * k], ey = vectors[3 * k + 1], ez = vectors[3 * k + 2];
        const VEC x = ex + (ux - LOAD(uj)), y = ey + (uy - LOAD(uj + PCI_BLOCK));
        const VEC z = ez + (uz - LOAD(uj + 2 * PCI_BLOCK));
        const VEC rx = x - (r[0] * ex + r[1] * ey + r[2] * ez);
        const VEC ry = y - (r[3] * ex + r[4] * ey + r[5] * ez);
        const VEC rz = z - (r[6] * ex + r[7] * ey + r[8] * ez);
        loss += rx * rx + ry * ry + rz * rz;
        sum[0] += rx, sum[1] += ry, sum[2] += rz;
        STORE(force, LOAD(force) - scale * rx);
        STORE(force + PCI_BLOCK, LOAD(force + PCI_BLOCK) - scale * ry);
        STORE(force + 2 * PCI_BLOCK, LOAD(force + 2 * PCI_BLOCK) - scale * rz);
        if (stretch != 0) {
            VEC length = x * x + y * y + z * z + (REAL)LENGTH_TOLERANCE;
            for (size_t l = 0; l < LANES; ++l) {
                length[l] = SQRT(length[l]);
            }
            const VEC factor = (REAL)2 - (REAL)2 * lengths[k] / length;
            stretched[0] += factor * x, stretched[1] += factor * y, stretched[2] += factor * z;
        }
    }
    for (size_t k = 0; k < 3; ++k) {
        own[k] += scale * sum[k] + stretch * stretched[k];
    }
    return loss;
}

// Half of dE/du of L_a: a_i is added at i, Kw_ij a_i taken from j. Returns a_i^2.
static inline __attribute__((always_inline)) VEC
NAME(scatter_attachment)(const pci_skin_data *data, size_t v, size_t lane, VEC own[3]) {
    const REAL *displacements = data->displacements, *weights = data->near_weights;
    const REAL *rest = data->attachment_rest;
    const REAL *u = &displacements[3 * PCI_BLOCK * v + lane];
    const REAL scale = (REAL)data->scale[2];
    REAL *forces = data->forces;
    VEC a[3];
    for (size_t k = 0; k < 3; ++k) {
        a[k] = rest[3 * v + k] + LOAD(u + k * PCI_BLOCK);
    }
    for (size_t e = data->near.offsets[v]; e < data->near.offsets[v + 1]; ++e) {
        const REAL *uj = &displacements[3 * PCI_BLOCK * (size_t)data->near.targets[e] + lane];
        for (size_t k = 0; k < 3; ++k) {
            a[k] -= weights[e] * LOAD(uj + k * PCI_BLOCK);
        }
    }
    for (size_t e = data->near.offsets[v]; e < data->near.offsets[v + 1]; ++e) {
        REAL *force = &forces[3 * PCI_BLOCK * (size_t)data->near.targets[e] + lane];
        const REAL share = scale * weights[e];
        for (size_t k = 0; k < 3; ++k) {
            STORE(force + k * PCI_BLOCK, LOAD(force + k * PCI_BLOCK) - share * a[k]);
        }
    }
    for (size_t k = 0; k < 3; ++k) {
        own[k] += scale * a[k];
    }
    return a[0] * a[0] + a[1] * a[1] + a[2] * a[2];
}

static void NAME(scatter)(const pci_skin_data *data, size_t vertex_count, pci_skin_sums *sums) {
    const REAL *displacements = data->displacements;
    REAL *quaternions = data->quaternions, *forces = data->forces;
    for (size_t v = 0; v < vertex_count; ++v) {
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            REAL *quaternion = &quaternions[8 * PCI_BLOCK * v + lane];
            NAME(guess_rotation)(quaternion, v > 0);
            VEC r[9], own[3] = {{0}, {0}, {0}};
            NAME(rotation_of)
            (&data->ring, displacements, v, lane, quaternion, r,
             sums != NULL ? sums->reflections : NULL);
            const VEC rigid =
                NAME(scatter_term)(&data->ring, displacements, v, lane, r, (REAL)data->scale[0],
                                   (REAL)data->scale[3], forces, own);
            NAME(rotation_of)
            (&data->near, displacements, v, lane, quaternion + 4 * PCI_BLOCK, r, NULL);
            const VEC collision = NAME(scatter_term)(&data->near, displacements, v, lane, r,
                                                     (REAL)data->scale[1], (REAL)0, forces, own);
            const VEC attachment = NAME(scatter_attachment)(data, v, lane, own);
            REAL *force = &forces[3 * PCI_BLOCK * v + lane];
            for (size_t k = 0; k < 3; ++k) {
                STORE(force + k * PCI_BLOCK, LOAD(force + k * PCI_BLOCK) + own[k]);
            }
            for (size_t l = 0; l < LANES && sums != NULL; ++l) {
                sums->rigid[lane + l] += (double)rigid[l];
                sums->collision[lane + l] += (double)collision[l];
                sums->attachment[lane + l] += (double)attachment[l];
            }
        }
    }
}

// dL/dw_ij = sum over frames of dL/du . d_j, added up by halves in a fixed tree.
static inline __attribute__((always_inline)) void NAME(add_row)(const pci_skin_data *data, size_t v,
                                                                const REAL *g) {
    const REAL *driver = data->driver;
    REAL *gradient = data->gradient;
    for (size_t k = 0; k < data->slots; ++k) {
        const size_t bone = data->bones[v * data->slots + k];
        const REAL *d = &driver[3 * PCI_BLOCK * bone];
        REAL products[PCI_BLOCK] __attribute__((aligned(64)));
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            STORE(&products[lane],
                  LOAD(&g[lane]) * LOAD(d + lane) +
                      LOAD(&g[PCI_BLOCK + lane]) * LOAD(d + PCI_BLOCK + lane) +
                      LOAD(&g[2 * PCI_BLOCK + lane]) * LOAD(d + 2 * PCI_BLOCK + lane));
        }
        for (size_t width = PCI_BLOCK / 2; width > 0; width /= 2) {
            for (size_t l = 0; l < width; ++l) {
                products[l] += products[l + width];
            }
        }
        gradient[v * data->slots + k] += (REAL)2 * products[0];
    }
}

static void NAME(collect)(const pci_skin_data *data, size_t begin, size_t end) {
    const REAL *forces = data->forces;
    for (size_t v = begin; v < end; ++v) {
        NAME(add_row)(data, v, &forces[3 * PCI_BLOCK * v]);
    }
}

// sum_j R_j e_ij over a list of edges.
static inline __attribute__((always_inline)) void
NAME(gather_rotated)(const uint32_t *targets, const REAL *vectors, size_t begin, size_t end,
                     const REAL *rotations, VEC sum[3]) {
    sum[0] = sum[1] = sum[2] = (VEC){0};
    for (size_t e = begin; e < end; ++e) {
        const REAL *r = &rotations[18 * PCI_BLOCK * (size_t)targets[e]];
        const REAL ex = vectors[3 * e], ey = vectors[3 * e + 1], ez = vectors[3 * e + 2];
        for (size_t k = 0; k < 3; ++k) {
            sum[k] += LOAD(r + 3 * k * PCI_BLOCK) * ex + LOAD(r + (3 * k + 1) * PCI_BLOCK) * ey +
                      LOAD(r + (3 * k + 2) * PCI_BLOCK) * ez;
        }
    }
}

static void NAME(gradient)(const pci_skin_data *data, size_t begin, size_t end) {
    const REAL *rotations = data->rotations, *residuals = data->residuals;
    const REAL *incoming_weights = data->incoming_weights;
    const REAL *incoming_vectors = data->incoming_vectors;
    const REAL rigid = (REAL)data->scale[0], collision = (REAL)data->scale[1];
    const REAL attachment = (REAL)data->scale[2];
    for (size_t v = begin; v < end; ++v) {
        // dL/du, half of it, for the whole block.
        REAL g[3][PCI_BLOCK] __attribute__((aligned(64)));
        const size_t ring_begin = data->ring.offsets[v], ring_end = data->ring.offsets[v + 1];
        const size_t in_begin = data->incoming_offsets[v], in_end = data->incoming_offsets[v + 1];
        for (size_t lane = 0; lane < PCI_BLOCK; lane += LANES) {
            VEC ring[3], near[3], attached[3] = {{0}, {0}, {0}};
            NAME(gather_rotated)
            (data->ring.targets, data->ring.vectors, ring_begin, ring_end, rotations + lane, ring);
            NAME(gather_rotated)
            (data->incoming, incoming_vectors, in_begin, in_end, rotations + 9 * PCI_BLOCK + lane,
             near);
            for (size_t e = in_begin; e < in_end; ++e) {
                const REAL *a = &residuals[6 * PCI_BLOCK * (size_t)data->incoming[e] + lane];
                for (size_t k = 0; k < 3; ++k) {
                    attached[k] += incoming_weights[e] * LOAD(a + k * PCI_BLOCK);
                }
            }
            const REAL *part = &residuals[(6 * v + 3) * PCI_BLOCK + lane];
            for (size_t k = 0; k < 3; ++k) {
                STORE(&g[k][lane], LOAD(part + k * PCI_BLOCK) - rigid * ring[k] -
                                       collision * near[k] - attachment * attached[k]);
            }
        }
        NAME(add_row)(data, v, &g[0][0]);
    }
}

const pci_skin_kernel NAME(pci_skin) = {
    .real_size = sizeof(REAL),
    .displace = NAME(displace),
    .fit = NAME(fit),
    .gradient = NAME(gradient),
    .scatter = NAME(scatter),
    .collect = NAME(collect),
};

#undef VEC
#undef MASK
#undef LOAD
#undef STORE
#undef SELECT
#undef REAL
#undef INTEGER
#undef LANES
#undef NAME
#undef SQRT
#undef LENGTH_TOLERANCE
#undef STEP_TOLERANCE
#undef CURVATURE_TOLERANCE
