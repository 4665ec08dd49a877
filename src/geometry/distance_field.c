// Based on: Jacobson, Kavan, Sorkine-Hornung, "Robust inside-outside segmentation using generalized
// winding numbers", 2013; Barill, Dickson, Schmidt, Levin, Jacobson, "Fast winding numbers for
// soups and clouds", 2018 (first order).
#include "geometry/distance_field.h"

#include "geometry/bvh.h"
#include "geometry/topology.h"

// ---- winding numbers ---------------------------------------------------------------------------

enum { LEAF_TRIANGLES = 8 };

// A node of a binary tree over `order`; seen from afar its triangles act as one dipole.
typedef struct winding_node {
    double centre[3], dipole[3]; // area-weighted centre, sum of area * normal
    double radius;               // of a ball around the centre that holds all corners
    uint32_t begin, end;         // triangles in `order`
    uint32_t second;             // second child, the first follows its parent; 0: a leaf
} winding_node;

typedef struct winding_tree {
    const pc_mesh *mesh;
    uint32_t *order;
    winding_node *nodes;
    size_t node_count;
} winding_tree;

static const double *corner(const pc_mesh *mesh, size_t triangle, size_t c) {
    return &mesh->positions[3 * (size_t)mesh->triangles[3 * triangle + c]];
}

static double centroid(const pc_mesh *mesh, size_t triangle, size_t k) {
    return (corner(mesh, triangle, 0)[k] + corner(mesh, triangle, 1)[k] +
            corner(mesh, triangle, 2)[k]) /
           3.0;
}

static void area_vector(const pc_mesh *mesh, size_t triangle, double out[3]) {
    pci_triangle_vector(mesh, triangle, out);
    for (size_t k = 0; k < 3; ++k) {
        out[k] *= 0.5;
    }
}

// Solid angle of a triangle (van Oosterom and Strackee, 1983).
static double solid_angle(const pc_mesh *mesh, size_t triangle, const double point[3]) {
    double a[3], b[3], c[3], normal[3];
    pci_sub(corner(mesh, triangle, 0), point, a);
    pci_sub(corner(mesh, triangle, 1), point, b);
    pci_sub(corner(mesh, triangle, 2), point, c);
    pci_cross(b, c, normal);
    const double la = pci_norm(a), lb = pci_norm(b), lc = pci_norm(c);
    const double divisor =
        la * lb * lc + pci_dot(a, b) * lc + pci_dot(b, c) * la + pci_dot(c, a) * lb;
    return 2.0 * atan2(pci_dot(a, normal), divisor);
}

static const double full_angle = 12.566370614359172;

double pci_winding_number(const pc_mesh *mesh, const double point[3]) {
    double sum = 0.0;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        sum += solid_angle(mesh, t, point);
    }
    return sum / full_angle;
}

static void measure_node(const winding_tree *tree, winding_node *node) {
    double total = 0.0, plain[3] = {0.0, 0.0, 0.0};
    for (uint32_t i = node->begin; i < node->end; ++i) {
        double area[3];
        area_vector(tree->mesh, tree->order[i], area);
        const double weight = pci_norm(area);
        total += weight;
        for (size_t k = 0; k < 3; ++k) {
            const double at = centroid(tree->mesh, tree->order[i], k);
            node->dipole[k] += area[k];
            node->centre[k] += weight * at;
            plain[k] += at;
        }
    }
    for (size_t k = 0; k < 3; ++k) {
        node->centre[k] =
            total > 0.0 ? node->centre[k] / total : plain[k] / (double)(node->end - node->begin);
    }
    double squared = 0.0;
    for (uint32_t i = node->begin; i < node->end; ++i) {
        for (size_t c = 0; c < 3; ++c) {
            squared = fmax(
                squared, pci_squared_distance(corner(tree->mesh, tree->order[i], c), node->centre));
        }
    }
    node->radius = sqrt(squared);
}

// Splits in the middle of the longest extent of the centroids; halves the list where that fails.
// The depth is below 64 as long boxes shrink by half each time, and a list cannot be halved more.
static void build_node(winding_tree *tree, uint32_t begin, uint32_t end) {
    winding_node *node = &tree->nodes[tree->node_count++];
    node->begin = begin;
    node->end = end;
    measure_node(tree, node);
    if (end - begin <= LEAF_TRIANGLES) {
        return;
    }
    double least[3], most[3];
    size_t axis = 0;
    for (size_t k = 0; k < 3; ++k) {
        least[k] = INFINITY;
        most[k] = -INFINITY;
        for (uint32_t i = begin; i < end; ++i) {
            const double at = centroid(tree->mesh, tree->order[i], k);
            least[k] = fmin(least[k], at);
            most[k] = fmax(most[k], at);
        }
        axis = most[k] - least[k] > most[axis] - least[axis] ? k : axis;
    }
    const double middle = 0.5 * (least[axis] + most[axis]);
    uint32_t split = begin;
    for (uint32_t i = begin; i < end; ++i) {
        if (centroid(tree->mesh, tree->order[i], axis) < middle) {
            const uint32_t swapped = tree->order[split];
            tree->order[split++] = tree->order[i];
            tree->order[i] = swapped;
        }
    }
    // Lists that lean to one side would make the tree deep.
    const uint32_t eighth = (end - begin) / 8;
    if (split - begin < eighth || end - split < eighth) {
        split = begin + (end - begin) / 2;
    }
    if (split == begin || split == end) {
        split = begin + (end - begin) / 2;
    }
    build_node(tree, begin, split);
    node->second = (uint32_t)tree->node_count;
    build_node(tree, split, end);
}

// Nodes farther than twice their radius count as dipoles: the error of the sum is then far below
// one half.
static double winding_at(const winding_tree *tree, const double point[3]) {
    uint32_t stack[128];
    size_t depth = 0;
    double sum = 0.0;
    stack[depth++] = 0;
    while (depth > 0) {
        const winding_node *node = &tree->nodes[stack[--depth]];
        double offset[3];
        pci_sub(node->centre, point, offset);
        const double distance = pci_norm(offset);
        if (distance > 2.0 * node->radius) {
            sum += pci_dot(offset, node->dipole) / (distance * distance * distance);
        } else if (node->second == 0 || depth + 2 > sizeof(stack) / sizeof(stack[0])) {
            for (uint32_t i = node->begin; i < node->end; ++i) {
                sum += solid_angle(tree->mesh, tree->order[i], point);
            }
        } else {
            stack[depth++] = node->second;
            stack[depth++] = (uint32_t)(node - tree->nodes) + 1;
        }
    }
    return sum / full_angle;
}

static bool build_tree(pci_scratch *scratch, const pc_mesh *mesh, winding_tree *tree) {
    tree->mesh = mesh;
    tree->order = PCI_SCRATCH(scratch, uint32_t, mesh->triangle_count);
    tree->nodes = PCI_SCRATCH(scratch, winding_node, 2 * mesh->triangle_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        tree->order[t] = (uint32_t)t;
    }
    build_node(tree, 0, (uint32_t)mesh->triangle_count);
    return true;
}

// ---- the field ---------------------------------------------------------------------------------

typedef struct fill_task {
    const pci_bvh *bvh;
    const winding_tree *tree;
    pci_distance_field *field;
    double reach;
    bool coarse; // only points with even numbers; else the others
} fill_task;

// A point whose numbers are all even lies at most this many cells away from any point.
static const double coarse_cells = 1.7320508075688772;

static void fill_point(const fill_task *task, const uint32_t at[3], size_t i) {
    pci_distance_field *field = task->field;
    const size_t row = field->size[0], slice = row * field->size[1];
    double point[3], squared = 0.0;
    for (size_t k = 0; k < 3; ++k) {
        point[k] = field->origin[k] + field->cell * (double)at[k];
        squared += at[k] % 2 != 0 ? field->cell * field->cell : 0.0;
    }
    // The sign is that of the coarse point next to it if no surface lies between; far outside of
    // the mesh a lower bound of the distance will do as well.
    const size_t near = (at[0] & ~1u) + row * (at[1] & ~1u) + slice * (at[2] & ~1u);
    const double away = sqrt(squared);
    bool known = false, inside = false;
    if (!task->coarse) {
        const double value = (double)field->values[near];
        known = fabs(value) > away * (1.0 + 1e-6);
        inside = value < 0.0;
        if (value > task->reach + coarse_cells * field->cell) {
            field->values[i] = (float)(value - away);
            field->triangles[i] = field->triangles[near];
            return;
        }
    }
    const pci_closest closest = pci_bvh_closest(task->bvh, point, INFINITY);
    inside = known ? inside : winding_at(task->tree, point) > 0.5;
    field->values[i] = (float)(inside ? -closest.distance : closest.distance);
    field->triangles[i] = closest.triangle;
}

static void fill_points(void *user, size_t begin, size_t end, uint32_t worker) {
    const fill_task *task = user;
    const pci_distance_field *field = task->field;
    (void)worker;
    for (size_t i = begin; i < end; ++i) {
        const uint32_t at[3] = {(uint32_t)(i % field->size[0]),
                                (uint32_t)(i / field->size[0] % field->size[1]),
                                (uint32_t)(i / field->size[0] / field->size[1])};
        if (((at[0] | at[1] | at[2]) % 2 == 0) == task->coarse) {
            fill_point(task, at, i);
        }
    }
}

pc_status pci_distance_field_build(pci_scratch *scratch, const char *stage, const pc_mesh *mesh,
                                   double cell, double margin, pci_distance_field *field) {
    pc_context *context = scratch->context;
    size_t count = 1;
    field->cell = cell;
    for (size_t k = 0; k < 3; ++k) {
        double least = INFINITY, most = -INFINITY;
        for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
            const double at = mesh->positions[3 * (size_t)mesh->triangles[i] + k];
            least = fmin(least, at);
            most = fmax(most, at);
        }
        const double points = ceil((most - least + 2.0 * margin) / cell) + 1.0;
        if (!(points < 4096.0)) {
            return pci_fail(context, PC_ERROR_TOO_LARGE, stage,
                            "%s: the distance field needs more than 4096 points along an axis",
                            stage);
        }
        field->origin[k] = least - margin;
        field->size[k] = points > 2.0 ? (uint32_t)points : 2;
        count *= field->size[k];
    }
    winding_tree tree = {0};
    field->values = PCI_SCRATCH(scratch, float, count);
    field->triangles = PCI_SCRATCH(scratch, uint32_t, count);
    if (scratch->failed || !build_tree(scratch, mesh, &tree)) {
        return pci_fail_memory(context, stage);
    }
    pci_bvh *bvh = NULL;
    pc_status status = pci_bvh_create(context, stage, mesh, &bvh);
    if (status == PC_OK) {
        fill_task task = {bvh, &tree, field, margin, true};
        bool wanted = pci_parallel_while_wanted(context, count, 1024, fill_points, &task);
        task.coarse = false;
        wanted = wanted && pci_parallel_while_wanted(context, count, 1024, fill_points, &task);
        status = wanted ? PC_OK : pci_fail_cancelled(context, stage);
    }
    pci_bvh_destroy(context, bvh);
    return status;
}

bool pci_distance_field_sample(const pci_distance_field *field, const double point[3],
                               double *distance, double gradient[3], size_t *nearest) {
    size_t at[3], next[3];
    double share[3];
    for (size_t k = 0; k < 3; ++k) {
        const double x = (point[k] - field->origin[k]) / field->cell;
        if (!(x >= 0.0 && x <= (double)(field->size[k] - 1))) {
            return false;
        }
        at[k] = (size_t)x < field->size[k] - 2 ? (size_t)x : field->size[k] - 2;
        share[k] = x - (double)at[k];
        next[k] = share[k] < 0.5 ? at[k] : at[k] + 1;
    }
    const size_t dy = field->size[0], dz = dy * field->size[1];
    const float *v = &field->values[at[0] + dy * at[1] + dz * at[2]];
    const double c[8] = {(double)v[0],       (double)v[1],          (double)v[dy],
                         (double)v[dy + 1],  (double)v[dz],         (double)v[dz + 1],
                         (double)v[dz + dy], (double)v[dz + dy + 1]};
    const double x = share[0], y = share[1], z = share[2];
    // Along x, then y, then z.
    const double x00 = c[0] + x * (c[1] - c[0]), x10 = c[2] + x * (c[3] - c[2]);
    const double x01 = c[4] + x * (c[5] - c[4]), x11 = c[6] + x * (c[7] - c[6]);
    const double y0 = x00 + y * (x10 - x00), y1 = x01 + y * (x11 - x01);
    *distance = y0 + z * (y1 - y0);
    gradient[0] = ((1 - z) * ((1 - y) * (c[1] - c[0]) + y * (c[3] - c[2])) +
                   z * ((1 - y) * (c[5] - c[4]) + y * (c[7] - c[6]))) /
                  field->cell;
    gradient[1] = ((1 - z) * (x10 - x00) + z * (x11 - x01)) / field->cell;
    gradient[2] = (y1 - y0) / field->cell;
    *nearest = next[0] + dy * next[1] + dz * next[2];
    return true;
}
