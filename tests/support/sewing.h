// A kit to sew garments from analytic surfaces: cloth around limbs, cuts, turned shapes, ribbons,
// and the ways in which game meshes are messy. Memory is not checked; pc_mesh_free releases meshes.
#ifndef TEST_SUPPORT_SEWING_H
#define TEST_SUPPORT_SEWING_H

#include <stdlib.h>

#include "geometry/topology.h"
#include "proxycloth/isosurface.h"
#include "support/surfaces.h"

#define SEW_PI 3.14159265358979323846

// Adds a piece, which is used up.
static inline void sew_add(pc_context *context, pc_mesh *garment, pc_mesh piece) {
    const double nowhere[3] = {0.0, 0.0, 0.0};
    pc_mesh sum = test_union(context, garment, &piece, nowhere);
    pc_mesh_free(context, garment);
    pc_mesh_free(context, &piece);
    *garment = sum;
}

static inline void sew_move(pc_mesh *mesh, double x, double y, double z) {
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        double *p = &mesh->positions[3 * v];
        p[0] += x, p[1] += y, p[2] += z;
    }
}

// Turns a mesh around the axis x, y or z through the origin, by a share of a full turn.
static inline void sew_turn(pc_mesh *mesh, size_t axis, double turns) {
    const double c = cos(2.0 * SEW_PI * turns), s = sin(2.0 * SEW_PI * turns);
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        double *p = &mesh->positions[3 * v], *a = &p[(axis + 1) % 3], *b = &p[(axis + 2) % 3];
        const double turned = c * *a - s * *b;
        *b = s * *a + c * *b;
        *a = turned;
    }
}

// ---- cloth around limbs -------------------------------------------------------------------------

// A cone with round ends; z counts `squash` times as far.
typedef struct sew_limb {
    double a[3], ra, b[3], rb;
} sew_limb;

typedef struct sew_body {
    const sew_limb *limbs;
    size_t count;
    double blend;  // radius of the fillets between limbs
    double squash; // bodies are flatter than wide
} sew_body;

// About the signed distance from the body.
static inline double sew_distance(const sew_body *body, const double point[3]) {
    double distance = INFINITY;
    for (size_t i = 0; i < body->count; ++i) {
        const sew_limb *l = &body->limbs[i];
        const double p[3] = {point[0], point[1], l->a[2] + (point[2] - l->a[2]) * body->squash};
        double along[3], away[3], on[3];
        pci_sub(l->b, l->a, along);
        pci_sub(p, l->a, away);
        const double t = fmin(fmax(pci_dot(along, away) / pci_dot(along, along), 0.0), 1.0);
        for (size_t k = 0; k < 3; ++k) {
            on[k] = l->a[k] + t * along[k];
        }
        const double d = sqrt(pci_squared_distance(p, on)) - (l->ra + t * (l->rb - l->ra));
        const double h = fmax(body->blend - fabs(d - distance), 0.0);
        distance = fmin(d, distance) - 0.25 * h * h / body->blend;
    }
    return distance;
}

static inline void sew_settle(const sew_body *body, double cell, double *p) {
    const double h = 0.01 * cell;
    for (int i = 0; i < 3; ++i) {
        double slope[3], square = 0.0;
        const double d = sew_distance(body, p);
        for (size_t k = 0; k < 3; ++k) {
            double q[3] = {p[0], p[1], p[2]};
            q[k] += h;
            slope[k] = (sew_distance(body, q) - d) / h;
            square += slope[k] * slope[k];
        }
        for (size_t k = 0; k < 3 && square > 1e-6; ++k) {
            p[k] -= fmin(fmax(d / square, -cell), cell) * slope[k];
        }
    }
}

// Evens out the triangles of marching cubes.
static inline void sew_relax(pc_context *context, const sew_body *body, double cell,
                             pc_mesh *mesh) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology t;
    double *next = PCI_SCRATCH(&scratch, double, 3 * mesh->vertex_count);
    pci_topology_build(&scratch, mesh, &t);
    for (int pass = 0; pass < 4; ++pass) {
        memset(next, 0, 3 * mesh->vertex_count * sizeof(*next));
        for (size_t v = 0; v < mesh->vertex_count; ++v) {
            const size_t first = t.ring_offsets[v], last = t.ring_offsets[v + 1];
            for (size_t i = 3 * first; i < 3 * last; ++i) {
                next[3 * v + i % 3] +=
                    mesh->positions[3 * (size_t)t.ring[i / 3] + i % 3] / (double)(last - first);
            }
            sew_settle(body, cell, &next[3 * v]);
        }
        memcpy(mesh->positions, next, 3 * mesh->vertex_count * sizeof(*next));
    }
    pci_scratch_end(&scratch);
}

// The closed surface of a body, with edges of about `cell`.
static inline pc_mesh sew_around(pc_context *context, const sew_body *body, double cell) {
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (size_t i = 0; i < body->count; ++i) {
        const sew_limb *l = &body->limbs[i];
        for (size_t k = 0; k < 3; ++k) {
            low[k] = fmin(low[k], fmin(l->a[k] - l->ra, l->b[k] - l->rb));
            high[k] = fmax(high[k], fmax(l->a[k] + l->ra, l->b[k] + l->rb));
        }
    }
    pc_grid grid = {.cell_size = cell, .band = 2.75 * cell};
    size_t points = 1;
    for (size_t k = 0; k < 3; ++k) {
        grid.origin[k] = low[k] - 5.0 * cell;
        grid.size[k] = (uint32_t)((high[k] - low[k]) / cell) + 11;
        points *= grid.size[k];
    }
    grid.samples = PCI_ALLOCATE(context, uint64_t, points);
    grid.values = PCI_ALLOCATE(context, float, points);
    for (size_t i = 0; i < points; ++i) {
        const size_t at[3] = {i % grid.size[0], i / grid.size[0] % grid.size[1],
                              i / grid.size[0] / grid.size[1]};
        double p[3];
        for (size_t k = 0; k < 3; ++k) {
            p[k] = grid.origin[k] + cell * (double)at[k];
        }
        const double value = fmax(0.0, sew_distance(body, p) + cell);
        if (value < grid.band) {
            grid.samples[grid.sample_count] = i;
            grid.values[grid.sample_count++] = (float)value;
        }
    }
    pc_mesh mesh = {0};
    if (pc_isosurface(context, &grid, NULL, &mesh, NULL) == PC_OK) {
        sew_relax(context, body, cell, &mesh);
    }
    pc_grid_free(context, &grid);
    return mesh;
}

// ---- scissors -----------------------------------------------------------------------------------

// What lies beyond the plane through `at`, or with a `size` in the box around it.
typedef struct sew_cut {
    double at[3], normal[3];
    double size[3];
    double within; // a plane cuts only so far around `at`; 0: everywhere
} sew_cut;

// Positive inside the cut.
static inline double sew_inside(const sew_cut *cut, const double p[3]) {
    double away[3], depth = INFINITY;
    pci_sub(p, cut->at, away);
    if (cut->size[0] > 0.0) {
        for (size_t k = 0; k < 3; ++k) {
            depth = fmin(depth, cut->size[k] - fabs(away[k]));
        }
        return depth;
    }
    depth = pci_dot(away, cut->normal) / pci_norm(cut->normal);
    return cut->within > 0.0 ? fmin(depth, cut->within - pci_norm(away)) : depth;
}

typedef struct sew_place {
    double p[3];
    uint32_t v;
} sew_place;

static inline int sew_compare_places(const void *left, const void *right) {
    const sew_place *a = left, *b = right;
    const int order = memcmp(a->p, b->p, sizeof(a->p));
    return order != 0 ? order : (a->v > b->v) - (a->v < b->v);
}

// Joins vertices at equal positions and leaves out what no triangle uses.
static inline void sew_weld(pc_context *context, pc_mesh *mesh) {
    pci_scratch scratch = pci_scratch_begin(context);
    sew_place *places = PCI_SCRATCH(&scratch, sew_place, mesh->vertex_count);
    uint32_t *first = PCI_SCRATCH(&scratch, uint32_t, mesh->vertex_count);
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        for (size_t k = 0; k < 3; ++k) {
            places[v].p[k] = mesh->positions[3 * v + k] + 0.0; // no -0
        }
        places[v].v = (uint32_t)v;
    }
    qsort(places, mesh->vertex_count, sizeof(*places), sew_compare_places);
    for (size_t i = 0, run = 0; i < mesh->vertex_count; ++i) {
        run = memcmp(places[run].p, places[i].p, sizeof(places[i].p)) == 0 ? run : i;
        first[places[i].v] = places[run].v;
    }
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        mesh->triangles[i] = first[mesh->triangles[i]];
    }
    pc_mesh welded = {0};
    pci_mesh_compact(&scratch, mesh, NULL, &welded, NULL);
    pci_scratch_end(&scratch);
    pc_mesh_free(context, mesh);
    *mesh = welded;
}

// Moves vertices onto the outline of a cut where one is near on an edge, so that no slivers arise.
static inline void sew_snap(const pc_mesh *mesh, double *depth) {
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        const uint32_t a = mesh->triangles[i];
        const uint32_t b = mesh->triangles[i % 3 == 2 ? i - 2 : i + 1];
        for (int side = 0; side < 2; ++side) {
            const size_t near = side == 0 ? a : b, far = side == 0 ? b : a;
            const double t = depth[near] / (depth[near] - depth[far]);
            if (depth[near] * depth[far] < 0.0 && t < 0.25) {
                for (size_t k = 0; k < 3; ++k) {
                    mesh->positions[3 * near + k] +=
                        t * (mesh->positions[3 * far + k] - mesh->positions[3 * near + k]);
                }
                depth[near] = 0.0;
            }
        }
    }
}

// Cuts a piece away; with `keep` it is what remains.
static inline void sew_cut_away(pc_context *context, pc_mesh *mesh, const sew_cut *cut, bool keep) {
    pci_scratch scratch = pci_scratch_begin(context);
    double *depth = PCI_SCRATCH(&scratch, double, mesh->vertex_count);
    for (size_t v = 0; v < mesh->vertex_count; ++v) {
        depth[v] = (keep ? -1.0 : 1.0) * sew_inside(cut, &mesh->positions[3 * v]);
    }
    sew_snap(mesh, depth);
    const size_t most = 2 * mesh->triangle_count, nv = mesh->vertex_count;
    pc_mesh out = {nv, PCI_ALLOCATE(context, double, 3 * (nv + 2 * most)), 0,
                   PCI_ALLOCATE(context, uint32_t, 3 * most)};
    memcpy(out.positions, mesh->positions, 3 * nv * sizeof(double));
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        uint32_t polygon[4], count = 0;
        for (size_t c = 0; c < 3; ++c) {
            const uint32_t a = mesh->triangles[3 * t + c], b = mesh->triangles[3 * t + (c + 1) % 3];
            if (depth[a] <= 0.0) {
                polygon[count++] = a;
            }
            if (depth[a] * depth[b] < 0.0) {
                const size_t low = a < b ? a : b, high = a < b ? b : a;
                const double share = depth[low] / (depth[low] - depth[high]);
                for (size_t k = 0; k < 3; ++k) {
                    const double p = mesh->positions[3 * low + k];
                    out.positions[3 * out.vertex_count + k] =
                        p + share * (mesh->positions[3 * high + k] - p);
                }
                polygon[count++] = (uint32_t)out.vertex_count++;
            }
        }
        for (uint32_t i = 2; i < count; ++i) {
            const uint32_t corners[3] = {polygon[0], polygon[i - 1], polygon[i]};
            const bool flat = depth[mesh->triangles[3 * t]] == 0.0 &&
                              depth[mesh->triangles[3 * t + 1]] == 0.0 &&
                              depth[mesh->triangles[3 * t + 2]] == 0.0;
            if (!flat) {
                memcpy(&out.triangles[3 * out.triangle_count++], corners, sizeof(corners));
            }
        }
    }
    pci_scratch_end(&scratch);
    pc_mesh_free(context, mesh);
    *mesh = out;
    sew_weld(context, mesh);
}

// ---- turned shapes and ribbons ------------------------------------------------------------------

// A profile (radius, height) turned around the y axis; 0 turns from the +z axis towards +x.
typedef struct sew_lathe {
    double profile[8][2];
    uint32_t points;
    uint32_t around, along;
    double from, to; // in turns; a full turn is closed
    double squash;   // of z; 0: 1
    uint32_t pleats;
    double depth; // of the pleats at the end of the profile, relative to the radius
} sew_lathe;

static inline pc_mesh sew_turned(pc_context *context, const sew_lathe *l, double detail) {
    const bool closed = l->to - l->from >= 1.0;
    const uint32_t around = (uint32_t)fmax(4.0, detail * l->around);
    const uint32_t along = (uint32_t)fmax(l->points - 1.0, detail * l->along);
    pc_mesh mesh = test_grid(context, around, along, closed, false);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v];
        const double angle = 2.0 * SEW_PI * (l->from + p[0] * (l->to - l->from));
        const double at = p[1] * (l->points - 1.0), share = p[1];
        const uint32_t i = (uint32_t)fmin(at, l->points - 2.0);
        const double t = at - i, *a = l->profile[i], *b = l->profile[i + 1];
        const double pleat = 1.0 + share * l->depth * cos(angle * l->pleats);
        const double radius = (a[0] + t * (b[0] - a[0])) * pleat;
        p[0] = radius * sin(angle);
        p[1] = a[1] + t * (b[1] - a[1]);
        p[2] = radius * cos(angle) * (l->squash > 0.0 ? l->squash : 1.0);
    }
    sew_weld(context, &mesh);
    return mesh;
}

// Catmull-Rom through points with half a width vector each.
typedef struct sew_knot {
    double p[3], half[3];
} sew_knot;

static inline pc_mesh sew_ribbon(pc_context *context, const sew_knot *knots, size_t count,
                                 uint32_t across, uint32_t along, double detail) {
    pc_mesh mesh = test_grid(context, (uint32_t)fmax(1.0, detail * across),
                             (uint32_t)fmax((double)count - 1.0, detail * along), false, false);
    for (size_t v = 0; v < mesh.vertex_count; ++v) {
        double *p = &mesh.positions[3 * v], row[6];
        const double side = 2.0 * p[0] - 1.0, at = p[1] * ((double)count - 1.0);
        const size_t i = (size_t)fmin(at, (double)count - 2.0);
        const double t = at - (double)i;
        const double *b = knots[i].p, *c = knots[i + 1].p;
        const double *a = i > 0 ? knots[i - 1].p : b, *d = i + 2 < count ? knots[i + 2].p : c;
        for (size_t k = 0; k < 6; ++k) {
            row[k] = b[k] + 0.5 * t *
                                (c[k] - a[k] +
                                 t * (2.0 * a[k] - 5.0 * b[k] + 4.0 * c[k] - d[k] +
                                      t * (3.0 * (b[k] - c[k]) + d[k] - a[k])));
        }
        for (size_t k = 0; k < 3; ++k) {
            p[k] = row[k] + side * row[3 + k];
        }
    }
    return mesh;
}

// A closed button or stud.
static inline pc_mesh sew_button(pc_context *context, double radius, double thickness) {
    const sew_lathe lathe = {
        .profile = {{0.0, 0.0}, {radius, 0.0}, {radius, thickness}, {0.0, thickness}},
        .points = 4,
        .around = 8,
        .along = 3,
        .to = 1.0};
    return sew_turned(context, &lathe, 1.0);
}

// ---- layers and mess ----------------------------------------------------------------------------

// A copy, moved along its normals and with the other winding where `reversed`.
static inline pc_mesh sew_offset(pc_context *context, const pc_mesh *mesh, double distance,
                                 bool reversed) {
    const pc_mesh none = {0};
    const double nowhere[3] = {0.0, 0.0, 0.0};
    pc_mesh copy = test_union(context, &none, mesh, nowhere);
    double *normals = PCI_ALLOCATE(context, double, 3 * mesh->vertex_count);
    pci_vertex_normals(mesh, normals);
    for (size_t i = 0; i < 3 * mesh->vertex_count; ++i) {
        copy.positions[i] += distance * normals[i];
    }
    pc_release(context, normals);
    for (size_t t = 0; reversed && t < mesh->triangle_count; ++t) {
        copy.triangles[3 * t + 1] = mesh->triangles[3 * t + 2];
        copy.triangles[3 * t + 2] = mesh->triangles[3 * t + 1];
    }
    return copy;
}

// Makes a sheet a closed shell.
static inline void sew_thicken(pc_context *context, pc_mesh *mesh, double thickness) {
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    pci_topology_build(&scratch, mesh, &topology);
    const uint32_t nv = (uint32_t)mesh->vertex_count;
    pc_mesh rim = {2 * mesh->vertex_count, PCI_ALLOCATE(context, double, 6 * mesh->vertex_count), 0,
                   PCI_ALLOCATE(context, uint32_t, 18 * mesh->triangle_count)};
    pc_mesh inside = sew_offset(context, mesh, -thickness, true);
    memcpy(rim.positions, mesh->positions, 3 * mesh->vertex_count * sizeof(double));
    memcpy(&rim.positions[3 * (size_t)nv], inside.positions,
           3 * mesh->vertex_count * sizeof(double));
    for (size_t i = 0; i < 3 * mesh->triangle_count; ++i) {
        const size_t e = topology.triangle_edges[i];
        if (e != PC_INVALID_INDEX &&
            topology.edge_triangle_offsets[e + 1] - topology.edge_triangle_offsets[e] == 1) {
            const uint32_t a = mesh->triangles[i];
            const uint32_t b = mesh->triangles[i % 3 == 2 ? i - 2 : i + 1];
            const uint32_t quad[6] = {b, a, a + nv, b, a + nv, b + nv};
            memcpy(&rim.triangles[3 * rim.triangle_count], quad, sizeof(quad));
            rim.triangle_count += 2;
        }
    }
    pci_scratch_end(&scratch);
    sew_add(context, mesh, inside);
    sew_add(context, mesh, rim);
    sew_weld(context, mesh);
}

// Turns the winding of every so many-th triangle, in patches.
static inline void sew_flip_patches(pc_mesh *mesh, size_t patch) {
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        if (t / patch % 3 == 0) {
            const uint32_t second = mesh->triangles[3 * t + 1];
            mesh->triangles[3 * t + 1] = mesh->triangles[3 * t + 2];
            mesh->triangles[3 * t + 2] = second;
        }
    }
}

// Gives every triangle vertices of its own, which miss each other by up to `gap`.
static inline void sew_crack(pc_context *context, pc_mesh *mesh, double gap) {
    const size_t corners = 3 * mesh->triangle_count;
    pc_mesh soup = {corners, PCI_ALLOCATE(context, double, 3 * corners), mesh->triangle_count,
                    PCI_ALLOCATE(context, uint32_t, corners)};
    for (size_t i = 0; i < corners; ++i) {
        soup.triangles[i] = (uint32_t)i;
        for (size_t k = 0; k < 3; ++k) {
            soup.positions[3 * i + k] = mesh->positions[3 * (size_t)mesh->triangles[i] + k] +
                                        gap * (pci_random(1, k, i) - 0.5);
        }
    }
    pc_mesh_free(context, mesh);
    *mesh = soup;
}

#endif
