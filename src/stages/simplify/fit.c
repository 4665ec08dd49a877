#include "stages/simplify/fit.h"

#include "geometry/triangle_distance.h"
#include "stages/simplify/improve.h"

enum { grain = 512, face_grain = 16 };

// How far a vertex may leave the fine surface, in wanted edge lengths. Three edges around a round
// tube of radius r are nearest to it with their corners r / 3 outside, .144 of their length; more
// edges need less. What goes farther is a spike: many samples around one vertex can pull it out to
// where no face follows.
static const double farthest = 0.15;

// Samples for each coarse vertex, about, where the fine mesh is dense; more change little.
static const size_t most_samples = 32;

// Passes over what is far from the faces at last.
static const size_t chase_passes = PCI_EFFORT(4, 1);

// Each fine vertex is a sample that holds on to the nearest coarse triangle or, if it lies on the
// border, to the nearest coarse border edge: hems are fitted to hems, from inside and outside.
typedef struct fitting {
    pci_relaxation *relaxation;
    const double *areas, *arcs;
    size_t stride;       // every so many of them counts, and all on the border
    uint32_t *elements;  // per sample, triangle or border half-edge; first a vertex to start at
    double *barycentric; // per sample, 3; of a border edge origin, target, 0
    double *residuals;   // per sample, 3: from the coarse triangle to the sample
    double *squared;     // per sample, squared length of the residual
    double *faces;       // per coarse triangle and point of it, 4: nearest fine point, squared way
    double *pulls;       // per coarse vertex, 3: weighted sum of residuals
    double *pull_weights;
} fitting;

static double triangle_distance(const fitting *f, uint32_t t, const double point[3],
                                double bary[3]) {
    const pci_halfedge *coarse = f->relaxation->coarse;
    const uint32_t *corner = &coarse->corners[3 * (size_t)t];
    return pci_triangle_squared_distance(point, &coarse->positions[3 * (size_t)corner[0]],
                                         &coarse->positions[3 * (size_t)corner[1]],
                                         &coarse->positions[3 * (size_t)corner[2]], bary);
}

static double border_distance(const fitting *f, uint32_t h, const double point[3], double bary[3]) {
    const pci_halfedge *coarse = f->relaxation->coarse;
    const double *a = &coarse->positions[3 * (size_t)pci_origin(coarse, h)];
    const double *b = &coarse->positions[3 * (size_t)pci_target(coarse, h)];
    return pci_triangle_squared_distance(point, a, b, b, bary);
}

// Walks along the border to the nearest edge.
static uint32_t nearest_border(const fitting *f, uint32_t h, const double point[3]) {
    const pci_halfedge *coarse = f->relaxation->coarse;
    double bary[3], best = border_distance(f, h, point, bary);
    for (bool moved = true; moved;) {
        const uint32_t sides[2] = {coarse->outgoing[pci_target(coarse, h)],
                                   pci_border_incoming(coarse, pci_origin(coarse, h))};
        moved = false;
        for (size_t i = 0; i < 2; ++i) {
            const double distance = border_distance(f, sides[i], point, bary);
            if (distance < best) {
                best = distance;
                h = sides[i];
                moved = true;
            }
        }
    }
    return h;
}

// Walks over the triangles, starting around coarse vertex v, to one that holds the nearest point
// inside or that no triangle around that point beats. Returns the squared distance.
static double nearest_triangle(const fitting *f, uint32_t v, const double point[3],
                               uint32_t *triangle, double bary[3]) {
    enum { most_tried = 32 };
    const pci_halfedge *coarse = f->relaxation->coarse;
    double best = INFINITY, tried_bary[3];
    uint32_t around[2] = {v, PC_INVALID_INDEX}; // vertices of the edge that the point is on
    uint32_t tried[most_tried];
    size_t tried_count = 0;
    for (bool moved = true; moved;) {
        moved = false;
        for (size_t i = 0; i < 2 && around[i] != PC_INVALID_INDEX; ++i) {
            PCI_FOR_OUTGOING(coarse, around[i], h) {
                size_t k = 0;
                while (k < tried_count && tried[k] != h / 3) {
                    ++k;
                }
                if (k < tried_count) {
                    continue;
                }
                if (tried_count < most_tried) {
                    tried[tried_count++] = h / 3;
                }
                const double distance = triangle_distance(f, h / 3, point, tried_bary);
                if (distance < best) {
                    best = distance;
                    *triangle = h / 3;
                    memcpy(bary, tried_bary, sizeof(tried_bary));
                    moved = true;
                }
            }
        }
        size_t count = 0;
        around[0] = around[1] = PC_INVALID_INDEX;
        for (size_t c = 0; moved && c < 3; ++c) {
            if (bary[c] > 0.0 && count++ < 2) {
                around[count - 1] = coarse->corners[3 * (size_t)*triangle + c];
            }
        }
        moved = moved && count < 3;
    }
    return best;
}

// The three coarse vertices that carry sample s, their shares in f->barycentric.
static void sample_vertices(const fitting *f, size_t s, uint32_t vertices[3]) {
    const pci_halfedge *coarse = f->relaxation->coarse;
    if (f->arcs[s] > 0.0) {
        vertices[0] = pci_origin(coarse, f->elements[s]);
        vertices[1] = vertices[2] = pci_target(coarse, f->elements[s]);
    } else {
        memcpy(vertices, &coarse->corners[3 * (size_t)f->elements[s]], sizeof(uint32_t[3]));
    }
}

// Neighbours are next to each other in memory, so that these are evenly spread.
static bool counts(const fitting *f, size_t s) { return f->arcs[s] > 0.0 || s % f->stride == 0; }

// Brings the samples up to date. They walk, so they never jump to another sheet.
static void find_residuals(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    fitting *f = user;
    const pci_halfedge *coarse = f->relaxation->coarse;
    for (size_t s = begin; s < end; ++s) {
        if (!counts(f, s)) {
            continue;
        }
        const double *point = &f->relaxation->fine->positions[3 * s];
        double *bary = &f->barycentric[3 * s];
        if (f->arcs[s] > 0.0) {
            f->elements[s] = nearest_border(f, f->elements[s], point);
            f->squared[s] = border_distance(f, f->elements[s], point, bary);
        } else {
            f->squared[s] = nearest_triangle(f, f->elements[s], point, &f->elements[s], bary);
        }
        uint32_t vertices[3];
        sample_vertices(f, s, vertices);
        for (size_t k = 0; k < 3; ++k) {
            f->residuals[3 * s + k] = point[k];
            for (size_t c = 0; c < 3; ++c) {
                f->residuals[3 * s + k] -= bary[c] * coarse->positions[3 * (size_t)vertices[c] + k];
            }
        }
    }
}

// Each vertex is pulled by the residuals of the samples around it, weighted by their squares: a
// step towards the least sum of fourth powers, which minds the largest deviations. On borders it is
// third powers: fourth ones leave the hem farther away on average, and no less at most.
static void sum_pulls(fitting *f) {
    const pci_halfedge *coarse = f->relaxation->coarse;
    memset(f->pulls, 0, 3 * coarse->vertex_count * sizeof(*f->pulls));
    memset(f->pull_weights, 0, coarse->vertex_count * sizeof(*f->pull_weights));
    for (size_t s = 0; s < f->relaxation->fine->vertex_count; ++s) {
        if (!counts(f, s)) {
            continue;
        }
        uint32_t vertices[3];
        sample_vertices(f, s, vertices);
        const bool on_border = f->arcs[s] > 0.0;
        for (size_t c = 0; c < 3; ++c) {
            const size_t v = vertices[c];
            if (!on_border && pci_is_hem_vertex(f->relaxation->mirror, coarse, (uint32_t)v)) {
                continue; // a hem follows the hem only
            }
            const double share = on_border ? f->arcs[s] * sqrt(f->squared[s])
                                           : (double)f->stride * f->areas[s] * f->squared[s];
            const double w = share * f->barycentric[3 * s + c];
            f->pull_weights[v] += w;
            for (size_t k = 0; k < 3; ++k) {
                f->pulls[3 * v + k] += w * f->residuals[3 * s + k];
            }
        }
    }
}

// The points of a coarse triangle that look at the fine surface, by barycentric coordinates.
enum { face_points = 4 };
static const double face_shares[face_points][3] = {
    {1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0}, {0.5, 0.5, 0.0}, {0.0, 0.5, 0.5}, {0.5, 0.0, 0.5}};

static void face_point(const pci_halfedge *coarse, const uint32_t *corner, size_t i,
                       double point[3]) {
    for (size_t k = 0; k < 3; ++k) {
        point[k] = 0.0;
        for (size_t c = 0; c < 3; ++c) {
            point[k] += face_shares[i][c] * coarse->positions[3 * (size_t)corner[c] + k];
        }
    }
}

static void find_face_targets(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const fitting *f = user;
    const pci_halfedge *coarse = f->relaxation->coarse;
    for (size_t t = begin; t < end; ++t) {
        const uint32_t *corner = &coarse->corners[3 * t];
        for (size_t i = 0; i < face_points; ++i) {
            double point[3], *target = &f->faces[4 * (face_points * t + i)];
            face_point(coarse, corner, i, point);
            pci_relax_nearest_of(f->relaxation, corner, 3, point, target, &target[3]);
        }
    }
}

// The other way round: points of the coarse triangles pull towards the fine surface, so that faces
// do not cut corners where no sample looks.
static void add_face_pulls(fitting *f) {
    const pci_halfedge *coarse = f->relaxation->coarse;
    for (uint32_t t = 0; t < coarse->triangle_count; ++t) {
        const uint32_t *corner = &coarse->corners[3 * (size_t)t];
        double normal[3];
        pci_normal_of(&coarse->positions[3 * (size_t)corner[0]],
                      &coarse->positions[3 * (size_t)corner[1]],
                      &coarse->positions[3 * (size_t)corner[2]], normal);
        const double area = 0.125 * pci_norm(normal); // a quarter of the triangle
        for (size_t i = 0; i < face_points; ++i) {
            const double *nearest = &f->faces[4 * (face_points * (size_t)t + i)];
            double point[3];
            face_point(coarse, corner, i, point);
            for (size_t c = 0; c < 3; ++c) {
                if (pci_is_hem_vertex(f->relaxation->mirror, coarse, corner[c])) {
                    continue;
                }
                const double w = area * nearest[3] * face_shares[i][c];
                f->pull_weights[corner[c]] += w;
                for (size_t k = 0; k < 3; ++k) {
                    f->pulls[3 * (size_t)corner[c] + k] += w * (nearest[k] - point[k]);
                }
            }
        }
    }
}

// Unit normal of the fan around a vertex, on the seam with its mirror image.
static void fan_normal(const pci_relaxation *r, uint32_t v, double normal[3]) {
    const pci_halfedge *coarse = r->coarse;
    memset(normal, 0, 3 * sizeof(*normal));
    PCI_FOR_OUTGOING(coarse, v, h) {
        const double *a = &coarse->positions[3 * (size_t)v];
        double n[3];
        pci_normal_of(a, &coarse->positions[3 * (size_t)pci_target(coarse, h)],
                      &coarse->positions[3 * (size_t)coarse->corners[pci_previous(h)]], n);
        for (size_t k = 0; k < 3; ++k) {
            normal[k] += n[k];
        }
    }
    if (pci_is_seam_vertex(r->mirror, coarse, v)) {
        normal[r->mirror->axis] = 0.0;
    }
    pci_normalize(normal);
}

// Where a vertex should be for equilateral triangles on its opposite edges: the mean of their
// apexes, weighted by what the angles lack. False: all edges are degenerate.
static bool find_apex(const pci_halfedge *coarse, uint32_t v, double target[3]) {
    static const double least_weight = 0.01;
    const double *at = &coarse->positions[3 * (size_t)v];
    double sum = 0.0;
    memset(target, 0, 3 * sizeof(*target));
    PCI_FOR_OUTGOING(coarse, v, h) {
        const double *b = &coarse->positions[3 * (size_t)pci_target(coarse, h)];
        const double *c = &coarse->positions[3 * (size_t)coarse->corners[pci_previous(h)]];
        double along[3], up[3];
        pci_sub(c, b, along);
        pci_sub(at, b, up);
        const double length = pci_norm(along);
        if (!pci_normalize(along)) {
            continue;
        }
        const double share = pci_dot(up, along);
        for (size_t k = 0; k < 3; ++k) {
            up[k] -= share * along[k];
        }
        if (!pci_normalize(up)) {
            continue;
        }
        const double w = 1.0 - pci_least_angle(at, b, c) / 60.0 + least_weight;
        for (size_t k = 0; k < 3; ++k) {
            target[k] += w * (0.5 * (b[k] + c[k]) + 0.5 * sqrt(3.0) * length * up[k]);
        }
        sum += w;
    }
    for (size_t k = 0; k < 3; ++k) {
        target[k] /= sum;
    }
    return sum > 0.0;
}

// The way towards even triangles, along the surface or along the border only.
static void sliding_step(const pci_relaxation *r, uint32_t v, double step[3]) {
    const pci_halfedge *coarse = r->coarse;
    const double *at = &coarse->positions[3 * (size_t)v];
    double target[3], axis[3];
    memset(step, 0, 3 * sizeof(*step));
    if (!find_apex(coarse, v, target)) {
        return;
    }
    pci_sub(target, at, step);
    const bool border = pci_is_hem_vertex(r->mirror, coarse, v);
    if (border) {
        const uint32_t next = pci_target(coarse, coarse->outgoing[v]);
        const uint32_t previous = pci_origin(coarse, pci_border_incoming(coarse, v));
        pci_sub(&coarse->positions[3 * (size_t)next], &coarse->positions[3 * (size_t)previous],
                axis);
        pci_normalize(axis);
    } else {
        fan_normal(r, v, axis);
    }
    const double share = pci_dot(step, axis);
    for (size_t k = 0; k < 3; ++k) {
        step[k] = border ? share * axis[k] : step[k] - share * axis[k];
    }
}

// Draws a vertex that is too far from the fine surface, or border, nearer.
static void limit_distance(const pci_relaxation *r, uint32_t v, double spacing) {
    double *at = &r->coarse->positions[3 * (size_t)v];
    double nearest[3];
    pci_relax_nearest(r, v, at, pci_is_border_vertex(r->coarse, v), nearest);
    const double distance = sqrt(pci_squared_distance(nearest, at));
    const double limit = farthest * spacing / r->scales[r->feet[v]];
    for (size_t k = 0; k < 3 && distance > limit; ++k) {
        at[k] = nearest[k] + limit / distance * (at[k] - nearest[k]);
    }
}

// Moves a vertex unless that spoils its triangles.
static void move_vertex(const fitting *f, uint32_t v, double spacing) {
    static const double good = 0.65, slide_share = 0.3, held_share = 0.2;
    const pci_relaxation *r = f->relaxation;
    double *at = &r->coarse->positions[3 * (size_t)v];
    const double start[3] = {at[0], at[1], at[2]};
    // Even triangles would turn the rings of a tube to a zigzag and draw borders off their bends.
    const bool held = r->pinned[v] == PCI_RINGED || pci_is_hem_vertex(r->mirror, r->coarse, v);
    const double slide = held ? held_share : slide_share;
    double step[3];
    sliding_step(r, v, step);
    for (size_t k = 0; k < 3; ++k) {
        step[k] *= slide;
        if (f->pull_weights[v] > 0.0) {
            step[k] += f->pulls[3 * (size_t)v + k] / f->pull_weights[v];
        }
    }
    if (pci_is_seam_vertex(r->mirror, r->coarse, v)) {
        step[r->mirror->axis] = 0.0;
    }
    const double length = pci_norm(step), limit = 0.25 * spacing;
    double share = length > limit ? limit / length : 1.0;
    const double before = pci_relax_quality(r, v);
    for (size_t attempt = 0; attempt < 3; ++attempt, share *= 0.5) {
        for (size_t k = 0; k < 3; ++k) {
            at[k] = start[k] + share * step[k];
        }
        limit_distance(r, v, spacing);
        const double after = pci_relax_quality(r, v);
        if (after >= before || after >= good) {
            return;
        }
    }
    memcpy(at, start, sizeof(start));
}

// Flips an edge that bridges a fold if the other diagonal lies in it and leaves good angles.
static void flip_into_fold(const pci_relaxation *r, uint32_t h, double spacing) {
    static const double bridging = 0.1, nearer = 0.7, kept_angle = 34.0;
    pci_halfedge *coarse = r->coarse;
    if (!pci_relax_may_flip(r, h)) {
        return;
    }
    const uint32_t g = coarse->twins[h];
    const double straying = pci_relax_straying(r, pci_origin(coarse, h), pci_target(coarse, h),
                                               false, bridging * spacing);
    if (straying < bridging * spacing ||
        pci_relax_straying(r, coarse->corners[pci_previous(h)], coarse->corners[pci_previous(g)],
                           false, 0.0) > nearer * straying ||
        !pci_can_flip(coarse, h)) {
        return;
    }
    const pci_fan_shape old[2] = {pci_shape_of_triangle(r, h / 3), pci_shape_of_triangle(r, g / 3)};
    const double angle = fmin(kept_angle, fmin(old[0].angle, old[1].angle));
    pci_flip(coarse, h);
    const pci_fan_shape flipped[2] = {pci_shape_of_triangle(r, h / 3),
                                      pci_shape_of_triangle(r, g / 3)};
    if (fmin(flipped[0].angle, flipped[1].angle) < angle ||
        flipped[0].turned + flipped[1].turned > old[0].turned + old[1].turned) {
        pci_flip(coarse, h - h % 3 + 1); // back
    }
}

// Brings the samples up to date. Flips renumber triangles and half-edges: starts again from the
// vertices.
static bool find_samples(const pci_scratch *scratch, fitting *f, const uint32_t *nearby) {
    const pci_halfedge *coarse = f->relaxation->coarse;
    const size_t samples = f->relaxation->fine->vertex_count;
    for (size_t s = 0; s < samples; ++s) {
        f->elements[s] = f->arcs[s] > 0.0 ? coarse->outgoing[nearby[s]] : nearby[s];
    }
    return pci_parallel_while_wanted(scratch->context, samples, grain, find_residuals, f);
}

// ---- outliers -----------------------------------------------------------------------------------

// The samples of each triangle, those of its border edges with them.
typedef struct sample_lists {
    size_t *offsets; // #triangles + 1
    uint32_t *samples;
} sample_lists;

static uint32_t triangle_of(const fitting *f, size_t s) {
    return f->arcs[s] > 0.0 ? f->elements[s] / 3 : f->elements[s];
}

static void list_samples(const fitting *f, sample_lists *lists) {
    const size_t triangles = f->relaxation->coarse->triangle_count;
    memset(lists->offsets, 0, (triangles + 1) * sizeof(*lists->offsets));
    for (size_t s = 0; s < f->relaxation->fine->vertex_count; ++s) {
        if (counts(f, s)) {
            ++lists->offsets[triangle_of(f, s)];
        }
    }
    size_t sum = 0;
    for (size_t t = 0; t <= triangles; ++t) {
        sum += lists->offsets[t];
        lists->offsets[t] = sum;
    }
    for (size_t s = f->relaxation->fine->vertex_count; s-- > 0;) {
        if (counts(f, s)) {
            lists->samples[--lists->offsets[triangle_of(f, s)]] = (uint32_t)s;
        }
    }
}

// Squared distance of a sample to the triangles around v, or to the border edges there.
static double distance_to_fan(const fitting *f, uint32_t v, size_t s) {
    const pci_halfedge *coarse = f->relaxation->coarse;
    const double *point = &f->relaxation->fine->positions[3 * s];
    double best = INFINITY, bary[3];
    if (f->arcs[s] > 0.0) {
        best = border_distance(f, f->elements[s], point, bary);
        if (pci_is_border_vertex(coarse, v)) {
            best = fmin(best, border_distance(f, coarse->outgoing[v], point, bary));
            best = fmin(best, border_distance(f, pci_border_incoming(coarse, v), point, bary));
        }
        return best;
    }
    PCI_FOR_OUTGOING(coarse, v, h) { best = fmin(best, triangle_distance(f, h / 3, point, bary)); }
    return best;
}

// The largest of these distances, of what the triangles around v hold; any above `enough` as soon
// as one is.
static double farthest_around(const fitting *f, const sample_lists *lists, uint32_t v,
                              double enough) {
    double most = 0.0;
    PCI_FOR_OUTGOING(f->relaxation->coarse, v, h) {
        for (size_t i = lists->offsets[h / 3]; i < lists->offsets[h / 3 + 1]; ++i) {
            most = fmax(most, distance_to_fan(f, v, lists->samples[i]));
            if (most > enough) {
                return most;
            }
        }
    }
    return most;
}

// Moves a vertex along the surface, or the border, towards one of its neighbours if that brings
// what is farthest from the triangles around it nearer, and keeps their angles.
static bool chase_outlier(const fitting *f, const sample_lists *lists, uint32_t v, double spacing) {
    static const double steps[] = {0.4, 0.2, 0.1}, nearer = 0.8, kept_angle = 34.0;
    pci_relaxation *r = f->relaxation;
    const pci_halfedge *coarse = r->coarse;
    double *at = &r->coarse->positions[3 * (size_t)v];
    const double start[3] = {at[0], at[1], at[2]};
    const uint32_t foot = r->feet[v];
    const pci_fan_shape old = pci_shape_of_fan(r, v);
    double best = nearer * farthest_around(f, lists, v, INFINITY);
    double origin[3], better[3] = {at[0], at[1], at[2]};
    uint32_t better_foot = foot;
    pci_relax_nearest(r, v, at, pci_is_border_vertex(coarse, v), origin);
    for (size_t i = 0; i < sizeof(steps) / sizeof(steps[0]); ++i) {
        PCI_FOR_OUTGOING(coarse, v, h) {
            const double *to = &coarse->positions[3 * (size_t)pci_target(coarse, h)];
            double target[3];
            for (size_t k = 0; k < 3; ++k) {
                target[k] = origin[k] + steps[i] * (to[k] - start[k]);
            }
            r->feet[v] = foot;
            memcpy(at, start, sizeof(start));
            pci_relax_move(r, v, target);
            for (size_t k = 0; k < 3; ++k) {
                at[k] += start[k] - origin[k];
            }
            const pci_fan_shape shape = pci_shape_of_fan(r, v);
            if (shape.angle < fmin(old.angle, kept_angle) || shape.turned > old.turned) {
                continue;
            }
            const double reached = farthest_around(f, lists, v, best);
            if (reached < best) {
                best = reached;
                better_foot = r->feet[v];
                memcpy(better, at, sizeof(better));
            }
        }
    }
    memcpy(at, better, sizeof(better));
    r->feet[v] = better_foot;
    limit_distance(r, v, spacing);
    return memcmp(better, start, sizeof(start)) != 0;
}

// Vertices around what is farthest from the faces move along the surface, so that these follow
// ridges, and borders their bends.
static bool chase_outliers(pci_scratch *scratch, fitting *f, const uint32_t *nearby,
                           double spacing) {
    // In expected edge lengths, on borders and elsewhere, and as a share of the largest squared
    // distance.
    static const double off_border = 0.14, outlying = 0.2, near_most = 0.4;
    // Farther away are sides that have fallen together: other clusters part them, not this.
    static const double fallen = 0.5;
    const pci_relaxation *r = f->relaxation;
    const pci_halfedge *coarse = r->coarse;
    sample_lists lists = {PCI_SCRATCH(scratch, size_t, coarse->triangle_count + 1),
                          PCI_SCRATCH(scratch, uint32_t, r->fine->vertex_count)};
    uint8_t *asked = PCI_SCRATCH(scratch, uint8_t, coarse->vertex_count);
    if (scratch->failed) {
        return false;
    }
    bool moved = true;
    for (size_t pass = 0; pass < chase_passes && moved; ++pass) {
        if (!find_samples(scratch, f, nearby)) {
            return false;
        }
        list_samples(f, &lists);
        memset(asked, 0, coarse->vertex_count);
        double most = 0.0;
        for (size_t s = 0; s < r->fine->vertex_count; ++s) {
            most = counts(f, s) ? fmax(most, f->squared[s]) : most;
        }
        if (most > fallen * fallen * spacing * spacing) {
            break;
        }
        const double limit = fmax(outlying * outlying * spacing * spacing, near_most * most);
        const double border_limit = off_border * off_border * spacing * spacing;
        for (size_t s = 0; s < r->fine->vertex_count; ++s) {
            if (counts(f, s) && f->squared[s] > (f->arcs[s] > 0.0 ? border_limit : limit)) {
                for (size_t c = 0; c < 3; ++c) {
                    asked[coarse->corners[3 * (size_t)triangle_of(f, s) + c]] = 1;
                }
            }
        }
        moved = false;
        for (uint32_t v = 0; v < coarse->vertex_count; ++v) {
            if (asked[v] && !r->pinned[v]) {
                moved |= chase_outlier(f, &lists, v, spacing);
            }
        }
    }
    return true;
}

bool pci_fit(pci_scratch *scratch, pci_relaxation *relaxation, const uint32_t *nearby,
             const double *areas, const double *arcs, double spacing, size_t passes) {
    const size_t samples = relaxation->fine->vertex_count;
    const pci_halfedge *coarse = relaxation->coarse;
    fitting f = {.relaxation = relaxation, .areas = areas, .arcs = arcs};
    f.stride = 1 + samples / (most_samples * coarse->vertex_count + 1);
    f.elements = PCI_SCRATCH(scratch, uint32_t, samples);
    f.barycentric = PCI_SCRATCH(scratch, double, 3 * samples);
    f.residuals = PCI_SCRATCH(scratch, double, 3 * samples);
    f.squared = PCI_SCRATCH(scratch, double, samples);
    f.faces = PCI_SCRATCH(scratch, double, 4 * face_points * coarse->triangle_count);
    f.pulls = PCI_SCRATCH(scratch, double, 3 * coarse->vertex_count);
    f.pull_weights = PCI_SCRATCH(scratch, double, coarse->vertex_count);
    if (scratch->failed) {
        return false;
    }
    for (size_t pass = 0; pass < passes; ++pass) {
        if (!find_samples(scratch, &f, nearby) ||
            !pci_parallel_while_wanted(scratch->context, coarse->triangle_count, face_grain,
                                       find_face_targets, &f)) {
            return false;
        }
        sum_pulls(&f);
        add_face_pulls(&f);
        for (uint32_t v = 0; v < coarse->vertex_count; ++v) {
            if (relaxation->pinned[v] != PCI_PINNED) {
                move_vertex(&f, v, spacing);
            }
        }
        pci_relax_flip(relaxation);
        for (uint32_t h = 0; h < 3 * coarse->triangle_count; ++h) {
            if (pci_is_edge(coarse, h)) {
                flip_into_fold(relaxation, h, spacing);
            }
        }
    }
    return chase_outliers(scratch, &f, nearby, spacing);
}
