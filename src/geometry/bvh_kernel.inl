// Traversal for one instruction set; included by bvh_kernel_*.c with
//   LANES            boxes per register, divides PCI_BVH_WIDTH; twice the triangles
//   SMALLER(a, b)    lane by lane; of variables
//   LARGER(a, b)
//   BITS(mask)       one bit per lane
//   WIDE_BITS(mask)
//   GATHER(at, k)    component k of the vectors that the pointers name
//   KERNEL           name of the result

typedef float VEC __attribute__((vector_size(LANES * sizeof(float)), may_alias));
typedef int32_t MASK __attribute__((vector_size(LANES * sizeof(float)), may_alias));
typedef float LOOSE __attribute__((vector_size(LANES * sizeof(float)), may_alias, aligned(4)));

typedef double WIDE __attribute__((vector_size(LANES * sizeof(float)), may_alias));
typedef int64_t WIDE_MASK __attribute__((vector_size(LANES * sizeof(float)), may_alias));
typedef double LOOSE_WIDE
    __attribute__((vector_size(LANES * sizeof(float)), may_alias, aligned(8)));

#define INLINE static inline __attribute__((always_inline))

INLINE VEC load(const float *p) { return *(const LOOSE *)(const void *)p; }
INLINE void store(float *p, VEC value) { *(LOOSE *)(void *)p = value; }
INLINE WIDE choose(WIDE_MASK mask, WIDE yes, WIDE no) {
    return (WIDE)((mask & (WIDE_MASK)yes) | (~mask & (WIDE_MASK)no));
}

// ---- stack --------------------------------------------------------------------------------------

// What remains to be visited, the nearest on top.
typedef struct pending {
    float distance;
    uint32_t child;
} pending;

enum { DEPTH = PCI_BVH_LEVELS * (PCI_BVH_WIDTH - 1) + 1 };

// Puts the children named by `bits` on the stack.
INLINE size_t push_children(pending *stack, size_t size, const pci_bvh_node *node,
                            const float *distances, uint32_t bits) {
    const size_t bottom = size;
    for (; bits != 0; bits &= bits - 1) {
        const int lane = __builtin_ctz(bits);
        const pending next = {distances[lane], node->child[lane]};
        size_t at = size++;
        for (; at > bottom && stack[at - 1].distance < next.distance; --at) {
            stack[at] = stack[at - 1];
        }
        stack[at] = next;
    }
    return size;
}

// ---- points -------------------------------------------------------------------------------------

// Squared distances of the boxes of a node; returns which are at most `most`.
INLINE uint32_t measure_boxes(const pci_bvh_node *node, const float point[3], float most,
                              float *distances) {
    uint32_t bits = 0;
    for (size_t l = 0; l < PCI_BVH_WIDTH; l += LANES) {
        VEC distance2 = {0};
        for (size_t k = 0; k < 3; ++k) {
            const VEC below = load(&node->lower[k][l]) - point[k], zero = {0};
            const VEC above = point[k] - load(&node->upper[k][l]);
            const VEC outside = LARGER(below, above);
            const VEC distance = LARGER(outside, zero);
            distance2 += distance * distance;
        }
        const MASK within = distance2 <= most;
        bits |= (uint32_t)BITS(within) << l;
        store(&distances[l], distance2);
    }
    return bits;
}

INLINE void find_corners(const pci_bvh_tree *tree, const pci_bvh_leaf *leaf, size_t corner,
                         size_t first, const double *at[LANES / 2]) {
    for (size_t i = 0; i < LANES / 2; ++i) {
        at[i] = &tree->positions[3 * (size_t)leaf->corners[corner][first + i]];
    }
}

typedef struct vector {
    WIDE x, y, z;
} vector;

INLINE vector subtract(vector a, vector b) { return (vector){a.x - b.x, a.y - b.y, a.z - b.z}; }
INLINE WIDE dot(vector a, vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE vector cross(vector a, vector b) {
    return (vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

// Takes the distance of the edge from `from` to `to` where that is less and not left out.
INLINE WIDE compare_edge(vector from, WIDE from2, WIDE to2, vector edge, WIDE length2,
                         WIDE_MASK compared, WIDE best) {
    const WIDE along = -dot(from, edge), fraction = along / length2, zero = {0};
    const vector r = {from.x + fraction * edge.x, from.y + fraction * edge.y,
                      from.z + fraction * edge.z};
    const WIDE distance2 = choose(along > zero, choose(along < length2, dot(r, r), to2), from2);
    return choose(compared & (distance2 < best), distance2, best);
}

// The arithmetic of triangle_distance.c, all ways at once.
INLINE void measure_triangles(const pci_bvh_tree *tree, const pci_bvh_leaf *leaf,
                              const double point[3], double *distances2) {
    for (size_t l = 0; l < PCI_BVH_LEAF; l += LANES / 2) {
        vector corner[3], from[3], edge[3];
        for (size_t c = 0; c < 3; ++c) {
            const double *at[LANES / 2];
            find_corners(tree, leaf, c, l, at);
            corner[c] = (vector){GATHER(at, 0), GATHER(at, 1), GATHER(at, 2)};
            from[c] =
                (vector){corner[c].x - point[0], corner[c].y - point[1], corner[c].z - point[2]};
        }
        WIDE length2[3], from2[3], w[3];
        for (size_t c = 0; c < 3; ++c) {
            edge[c] = subtract(corner[(c + 1) % 3], corner[c]);
            length2[c] = dot(edge[c], edge[c]);
            from2[c] = dot(from[c], from[c]);
        }
        const vector normal = cross(edge[0], edge[1]);
        for (size_t c = 0; c < 3; ++c) {
            w[(c + 2) % 3] = dot(cross(from[c], edge[c]), normal);
        }
        const WIDE zero = {0}, infinite = zero + (double)INFINITY;
        const WIDE_MASK sliver = ~(dot(normal, normal) > 1e-6 * length2[0] * length2[2]);
        const WIDE sum = w[0] + w[1] + w[2], u = w[1] / sum, v = w[2] / sum;
        const vector r = {from[0].x + u * edge[0].x - v * edge[2].x,
                          from[0].y + u * edge[0].y - v * edge[2].y,
                          from[0].z + u * edge[0].z - v * edge[2].z};
        WIDE best = choose((w[0] > zero) & (w[1] > zero) & (w[2] > zero), dot(r, r), infinite);
        for (size_t c = 0; c < 3; ++c) {
            const size_t next = (c + 1) % 3;
            best = compare_edge(from[c], from2[c], from2[next], edge[c], length2[c],
                                sliver | ~(w[(c + 2) % 3] > zero), best);
        }
        *(LOOSE_WIDE *)(void *)&distances2[l] = best;
    }
}

static float squared(float radius) {
    const float square = radius * radius;
    return square <= FLT_MAX ? square : FLT_MAX;
}

static void around(const pci_bvh_tree *tree, const pci_bvh_ball *ball, pci_bvh_visit visit,
                   void *user) {
    pending stack[DEPTH];
    stack[0] = (pending){0.0F, 0};
    float radius = ball->radius, most = squared(radius);
    for (size_t size = 1; size > 0;) {
        const pending next = stack[--size];
        if (next.distance > most) {
            continue;
        }
        if ((next.child & 1) == 0) {
            const pci_bvh_node *node = &tree->nodes[next.child / 2];
            float distances[PCI_BVH_WIDTH];
            const uint32_t bits = measure_boxes(node, ball->centre, most, distances);
            size = push_children(stack, size, node, distances, bits);
            continue;
        }
        const pci_bvh_leaf *leaf = &tree->leaves[next.child / 2];
        double distances2[PCI_BVH_LEAF];
        measure_triangles(tree, leaf, ball->point, distances2);
        radius = visit(user, leaf, distances2, radius);
        if (radius < 0.0F) {
            return;
        }
        most = squared(radius);
    }
}

// ---- rays ---------------------------------------------------------------------------------------

typedef struct beam {
    float start[3];
    float inverse[3]; // of the direction
    size_t side[3];   // 1: it comes from above
} beam;

// Where the beam enters the boxes of a node; returns those that it meets within `reach`.
INLINE uint32_t pierce_boxes(const pci_bvh_node *node, const beam *line, float reach,
                             float *distances) {
    uint32_t bits = 0;
    for (size_t l = 0; l < PCI_BVH_WIDTH; l += LANES) {
        VEC enter = {0}, leave = enter + reach;
        for (size_t k = 0; k < 3; ++k) {
            const float *lower = &node->lower[k][l], *upper = &node->upper[k][l];
            const bool above = line->side[k] != 0;
            const VEC near = (load(above ? upper : lower) - line->start[k]) * line->inverse[k];
            const VEC far = (load(above ? lower : upper) - line->start[k]) * line->inverse[k];
            enter = LARGER(enter, near);
            leave = SMALLER(leave, far);
        }
        const MASK met = enter <= leave;
        bits |= (uint32_t)BITS(met) << l;
        store(&distances[l], enter);
    }
    return bits;
}

// Triangles that the line through the ray meets: the arithmetic of bvh_rays.c.
INLINE uint32_t pierce_triangles(const pci_bvh_tree *tree, const pci_bvh_leaf *leaf,
                                 const pci_bvh_ray *ray) {
    uint32_t bits = 0;
    for (size_t l = 0; l < PCI_BVH_LEAF; l += LANES / 2) {
        WIDE x[3], y[3];
        for (size_t c = 0; c < 3; ++c) {
            const double *at[LANES / 2];
            find_corners(tree, leaf, c, l, at);
            const size_t i = ray->axis[0], j = ray->axis[1], k = ray->axis[2];
            const WIDE along = GATHER(at, k) - ray->origin[k];
            x[c] = GATHER(at, i) - ray->origin[i] - ray->shear[0] * along;
            y[c] = GATHER(at, j) - ray->origin[j] - ray->shear[1] * along;
        }
        const WIDE u = x[2] * y[1] - y[2] * x[1], v = x[0] * y[2] - y[0] * x[2];
        const WIDE w = x[1] * y[0] - y[1] * x[0], zero = {0};
        const WIDE_MASK outside =
            ((u < zero) | (v < zero) | (w < zero)) & ((u > zero) | (v > zero) | (w > zero));
        const WIDE_MASK met = ~outside;
        bits |= (uint32_t)WIDE_BITS(met) << l;
    }
    return bits;
}

static void along(const pci_bvh_tree *tree, const pci_bvh_ray *ray, pci_bvh_strike strike,
                  void *user) {
    beam line;
    for (size_t k = 0; k < 3; ++k) {
        // Over its length, such a step is far less than the padding.
        const float least = 1e-18F, step = ray->direction[k];
        line.start[k] = ray->start[k];
        line.inverse[k] = 1.0F / (fabsf(step) < least ? copysignf(least, step) : step);
        line.side[k] = line.inverse[k] < 0.0F;
    }
    pending stack[DEPTH];
    stack[0] = (pending){0.0F, 0};
    float reach = ray->reach;
    for (size_t size = 1; size > 0;) {
        const pending next = stack[--size];
        if (next.distance > reach) {
            continue;
        }
        if ((next.child & 1) == 0) {
            const pci_bvh_node *node = &tree->nodes[next.child / 2];
            float distances[PCI_BVH_WIDTH];
            const uint32_t bits = pierce_boxes(node, &line, reach, distances);
            size = push_children(stack, size, node, distances, bits);
            continue;
        }
        const pci_bvh_leaf *leaf = &tree->leaves[next.child / 2];
        const uint32_t met = pierce_triangles(tree, leaf, ray);
        if (met != 0) {
            reach = strike(user, leaf, met, reach);
        }
    }
}

const pci_bvh_kernel KERNEL = {around, along};
