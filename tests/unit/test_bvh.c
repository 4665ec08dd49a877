#include "geometry/bvh.h"

#include <stdlib.h>

#include "core/clock.h"
#include "geometry/bvh_tree.h"
#include "geometry/topology.h"
#include "support/surfaces.h"
#include "support/test.h"

// A soup of random triangles in a cube of side `size` around `offset`: large and small ones,
// slivers, segments and points.
static pc_mesh random_soup(pc_context *context, size_t triangles, uint64_t seed, double size,
                           double offset) {
    pc_mesh mesh = {.vertex_count = 3 * triangles, .triangle_count = triangles};
    mesh.positions = PCI_ALLOCATE(context, double, 9 * triangles);
    mesh.triangles = PCI_ALLOCATE(context, uint32_t, 3 * triangles);
    assert_non_null(mesh.positions);
    assert_non_null(mesh.triangles);
    for (size_t t = 0; t < triangles; ++t) {
        double *p = &mesh.positions[9 * t];
        const double extent = pci_random(seed, t, 100) < 0.3 ? 1.0 : 0.1;
        for (size_t k = 0; k < 3; ++k) {
            const double start = pci_random(seed, t, k);
            p[k] = offset + size * start;
            for (size_t c = 1; c < 3; ++c) {
                const double step = pci_random(seed, t, 3 * c + k) - 0.5;
                p[3 * c + k] = offset + size * (start + extent * step);
            }
        }
        if (t % 7 == 3) { // a segment, as exactly as rounding allows
            for (size_t k = 0; k < 3; ++k) {
                p[6 + k] = 0.25 * p[k] + 0.75 * p[3 + k];
            }
        } else if (t % 7 == 5) { // a point
            memcpy(p + 3, p, 3 * sizeof(double));
            memcpy(p + 6, p, 3 * sizeof(double));
        } else if (t % 7 == 6 && t > 6) { // the same triangle again: a tie everywhere
            memcpy(p, p - 9 * 6, 9 * sizeof(double));
        }
        for (size_t c = 0; c < 3; ++c) {
            mesh.triangles[3 * t + c] = (uint32_t)(3 * t + c);
        }
    }
    return mesh;
}

static const double *corner(const pc_mesh *mesh, size_t t, size_t c) {
    return &mesh->positions[3 * (size_t)mesh->triangles[3 * t + c]];
}

static pci_closest brute_force_closest(const pc_mesh *mesh, const double point[3], double radius) {
    pci_closest best = {.triangle = PC_INVALID_INDEX};
    double best2 = INFINITY;
    for (size_t t = 0; t < mesh->triangle_count; ++t) {
        double w[3];
        const double d2 = pci_triangle_squared_distance(point, corner(mesh, t, 0),
                                                        corner(mesh, t, 1), corner(mesh, t, 2), w);
        if (d2 < best2 && sqrt(d2) <= radius) {
            best2 = d2;
            best.triangle = (uint32_t)t;
            best.distance = sqrt(d2);
        }
    }
    return best;
}

// ---- distance to one triangle -------------------------------------------------------------------

static void triangle_distance_knows_its_regions(void **state) {
    (void)state;
    const double a[3] = {0, 0, 0}, b[3] = {2, 0, 0}, c[3] = {0, 2, 0};
    static const struct {
        double point[3], squared_distance, weights[3];
    } cases[] = {
        {{0.5, 0.5, 3}, 9, {0.5, 0.25, 0.25}}, // face
        {{-1, -1, 2}, 6, {1, 0, 0}},           // vertices
        {{4, -1, 0}, 5, {0, 1, 0}},
        {{-1, 5, 1}, 11, {0, 0, 1}},
        {{1, -2, 1}, 5, {0.5, 0.5, 0}}, // edges
        {{2, 2, 0}, 2, {0, 0.5, 0.5}},
        {{-3, 1, 0}, 9, {0.5, 0, 0.5}},
        {{1, 0, 0}, 0, {0.5, 0.5, 0}}, // on the triangle
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); ++i) {
        double w[3];
        assert_close(pci_triangle_squared_distance(cases[i].point, a, b, c, w),
                     cases[i].squared_distance, 1e-14);
        for (size_t k = 0; k < 3; ++k) {
            assert_close(w[k], cases[i].weights[k], 1e-15);
        }
    }
}

// The distance is convex over the triangle: no point of a fine subdivision may be closer, and the
// point that the weights name must have the distance.
static void triangle_distance_is_the_minimum(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh soup = random_soup(context, 70, 3, 1.0, 0.0);
    for (size_t i = 0; i < 2000; ++i) {
        const size_t t = i % soup.triangle_count;
        const double *v[3] = {corner(&soup, t, 0), corner(&soup, t, 1), corner(&soup, t, 2)};
        double point[3], w[3];
        for (size_t k = 0; k < 3; ++k) {
            point[k] = 2.0 * pci_random(4, i, k) - 0.5;
        }
        const double d2 = pci_triangle_squared_distance(point, v[0], v[1], v[2], w);
        assert_true(w[0] >= 0.0 && w[1] >= 0.0 && w[2] >= 0.0);
        assert_close(w[0] + w[1] + w[2], 1.0, 1e-15);
        double named[3] = {0};
        for (size_t k = 0; k < 3; ++k) {
            named[k] = w[0] * v[0][k] + w[1] * v[1][k] + w[2] * v[2][k];
        }
        assert_close(sqrt(pci_squared_distance(point, named)), sqrt(d2), 1e-14);
        const size_t steps = 24;
        for (size_t a = 0; a <= steps; ++a) {
            for (size_t b = 0; a + b <= steps; ++b) {
                const double s = (double)a / (double)steps, r = (double)b / (double)steps;
                double other[3];
                for (size_t k = 0; k < 3; ++k) {
                    other[k] = (1.0 - s - r) * v[0][k] + s * v[1][k] + r * v[2][k];
                }
                assert_true(sqrt(pci_squared_distance(point, other)) >= sqrt(d2) - 1e-14);
            }
        }
    }
    pc_mesh_free(context, &soup);
    pc_context_destroy(context);
}

// The kernels of all instruction sets, bit for bit.
static void triangle_distances_agree(void **state) {
    (void)state;
#if defined(__x86_64__)
    pc_context *context = test_context(1);
    pc_mesh soup = random_soup(context, 700, 12, 1.0, 0.0);
    for (size_t i = 0; i < 20000 && __builtin_cpu_supports("avx2"); ++i) {
        const size_t t = i % soup.triangle_count;
        const double *v[3] = {corner(&soup, t, 0), corner(&soup, t, 1), corner(&soup, t, 2)};
        double point[3], w[2][3], distances[2];
        for (size_t k = 0; k < 3; ++k) {
            point[k] = i % 9 == 0 ? v[i % 3][k] : 2.0 * pci_random(13, i, k) - 0.5;
        }
        distances[0] = pci_triangle_squared_distance_generic(point, v[0], v[1], v[2], w[0]);
        distances[1] = pci_triangle_squared_distance_avx2(point, v[0], v[1], v[2], w[1]);
        assert_memory_equal(&distances[0], &distances[1], sizeof(double));
        assert_memory_equal(w[0], w[1], sizeof(w[0]));
    }
    pc_mesh_free(context, &soup);
    pc_context_destroy(context);
#endif
}

// ---- closest points -----------------------------------------------------------------------------

static void closest_equals_brute_force(void **state) {
    (void)state;
    static const struct {
        double size, offset;
    } places[] = {{1.0, 0.0}, {1e-3, 0.0},  {1e4, -3e4}, {1e-3, 10.0},
                  {1.0, 1e6}, {1e-30, 0.0}, {1e30, 1e30}};
    pc_context *context = test_context(1);
    for (size_t place = 0; place < sizeof(places) / sizeof(places[0]); ++place) {
        const double size = places[place].size, offset = places[place].offset;
        pc_mesh soup = random_soup(context, 300, place, size, offset);
        pci_bvh *bvh = NULL;
        assert_ok(context, pci_bvh_create(context, "test", &soup, &bvh));
        for (size_t i = 0; i < 3000; ++i) {
            double point[3];
            const double spread = i % 10 == 0 ? 1000.0 : 2.0;
            for (size_t k = 0; k < 3; ++k) {
                point[k] = offset + size * spread * (pci_random(5, i, k) - 0.25);
            }
            if (i % 10 == 1) { // on a vertex, where many triangles may tie
                memcpy(point, &soup.positions[3 * (i % soup.vertex_count)], sizeof(point));
            }
            const double radius = i % 3 == 0 ? (double)INFINITY : i % 3 == 1 ? 0.1 * size : 0.0;
            const pci_closest expected = brute_force_closest(&soup, point, radius);
            bvh->kernel = i % 4 == 0 ? &pci_bvh_generic : pci_bvh_best_kernel();
            const pci_closest found = pci_bvh_closest(bvh, point, radius);
            assert_int_equal(found.triangle, expected.triangle);
            if (found.triangle != PC_INVALID_INDEX) {
                assert_true(found.distance == expected.distance);
                assert_close(sqrt(pci_squared_distance(found.point, point)), found.distance,
                             1e-15 * (fabs(offset) + spread * size) * 4.0);
            }
            // Hints good and bad change nothing.
            if (i % 3 == 0) {
                const uint32_t hint =
                    i % 2 == 0 ? (uint32_t)(i % soup.triangle_count) : expected.triangle;
                const pci_closest near = pci_bvh_closest_near(bvh, point, hint);
                assert_int_equal(near.triangle, expected.triangle);
                assert_true(near.distance == expected.distance);
            }
        }
        pci_bvh_destroy(context, bvh);
        pc_mesh_free(context, &soup);
    }
    pc_context_destroy(context);
}

// A walk with shorter and shorter steps finds what searches from scratch find, ties included.
static void moving_points_find_the_same(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh soup = random_soup(context, 300, 21, 1.0, 0.0);
    pci_bvh *bvh = NULL;
    assert_int_equal(pci_bvh_create(context, "test", &soup, &bvh), PC_OK);
    for (size_t walk = 0; walk < 200; ++walk) {
        pci_surroundings around = {0};
        double point[3], bound = INFINITY, margin = 0.1;
        for (size_t k = 0; k < 3; ++k) {
            point[k] = pci_random(22, walk, k);
        }
        for (size_t step = 0; step < 40; ++step) {
            const pci_closest moving =
                pci_bvh_closest_moving(bvh, point, bound, 3.0 * margin, &around);
            const pci_closest closest = pci_bvh_closest(bvh, point, INFINITY);
            assert_int_equal(moving.triangle, closest.triangle);
            assert_memory_equal(moving.point, closest.point, sizeof(closest.point));
            assert_memory_equal(&moving.distance, &closest.distance, sizeof(double));
            margin *= 0.8;
            for (size_t k = 0; k < 3; ++k) {
                point[k] += margin * (pci_random(23, 100 * walk + step, k) - 0.5);
            }
            bound = sqrt(pci_squared_distance(point, closest.point)) * (1.0 + 1e-6);
        }
    }
    pci_bvh_destroy(context, bvh);
    pc_mesh_free(context, &soup);
    pc_context_destroy(context);
}

// The same answers with any hint, which stays or becomes a triangle within the radius.
static void hints_change_no_answer(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh soup = random_soup(context, 300, 31, 1.0, 0.0);
    pci_bvh *bvh = NULL;
    assert_ok(context, pci_bvh_create(context, "test", &soup, &bvh));
    uint32_t hint = PC_INVALID_INDEX;
    size_t kept = 0, found = 0;
    for (size_t i = 0; i < 2000; ++i) {
        const double radius = 0.2 * pci_random(32, i, 3);
        double point[3], w[3];
        for (size_t k = 0; k < 3; ++k) {
            point[k] = 1.4 * pci_random(32, i / 4, k) - 0.2; // four radii each
        }
        const uint32_t before = hint;
        const bool within = pci_bvh_within_near(bvh, point, radius, &hint);
        assert_true(within ==
                    (brute_force_closest(&soup, point, radius).triangle != PC_INVALID_INDEX));
        assert_true(within == pci_bvh_within(bvh, point, radius));
        assert_true(within || hint == before);
        if (within) {
            const double d2 = pci_triangle_squared_distance(
                point, corner(&soup, hint, 0), corner(&soup, hint, 1), corner(&soup, hint, 2), w);
            assert_true(sqrt(d2) <= radius);
        }
        found += within;
        kept += within && hint == before;
    }
    assert_true(kept > 100 && found > kept + 100 && found < 1900);
    pci_bvh_destroy(context, bvh);
    pc_mesh_free(context, &soup);
    pc_context_destroy(context);
}

static void closest_survives_strange_points(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh soup = random_soup(context, 50, 9, 1.0, 0.0);
    pci_bvh *bvh = NULL;
    assert_ok(context, pci_bvh_create(context, "test", &soup, &bvh));
    static const double far[] = {1e4, 1e7, 1e12, 1e25};
    for (size_t i = 0; i < sizeof(far) / sizeof(far[0]); ++i) {
        const double point[3] = {far[i], -far[i], 0.5};
        const pci_closest expected = brute_force_closest(&soup, point, INFINITY);
        const pci_closest found = pci_bvh_closest(bvh, point, INFINITY);
        assert_int_equal(found.triangle, expected.triangle);
        assert_true(found.distance == expected.distance);
    }
    const double nan_point[3] = {0.0, NAN, 0.0}, inside[3] = {0.5, 0.5, 0.5};
    assert_int_equal(pci_bvh_closest(bvh, nan_point, INFINITY).triangle, PC_INVALID_INDEX);
    assert_int_equal(pci_bvh_closest(bvh, inside, -1.0).triangle, PC_INVALID_INDEX);
    assert_int_equal(pci_bvh_closest(bvh, inside, NAN).triangle, PC_INVALID_INDEX);
    pci_bvh_destroy(context, bvh);
    pc_mesh_free(context, &soup);
    pc_context_destroy(context);
}

// ---- rays ---------------------------------------------------------------------------------------

// Moeller-Trumbore in long double. Hits closer than `margin` to the outline of a triangle, or at a
// flat angle, are unsafe: rounding may decide them either way.
static bool reference_hit(const pc_mesh *mesh, size_t t, const double origin[3],
                          const double direction[3], pci_hit *hit, bool *unsafe) {
    const double *a = corner(mesh, t, 0), *b = corner(mesh, t, 1), *c = corner(mesh, t, 2);
    long double e1[3], e2[3], s[3], p[3], q[3];
    for (size_t k = 0; k < 3; ++k) {
        e1[k] = (long double)b[k] - a[k];
        e2[k] = (long double)c[k] - a[k];
        s[k] = (long double)origin[k] - a[k];
    }
    long double det = 0, u = 0, v = 0, distance = 0, n2 = 0, l2 = 0, d2 = 0;
    for (size_t k = 0; k < 3; ++k) {
        const size_t i = (k + 1) % 3, j = (k + 2) % 3;
        p[k] = (long double)direction[i] * e2[j] - (long double)direction[j] * e2[i];
        q[k] = s[i] * e1[j] - s[j] * e1[i];
        const long double n = e1[i] * e2[j] - e1[j] * e2[i];
        n2 += n * n, l2 += e1[k] * e1[k] + e2[k] * e2[k];
        d2 += (long double)direction[k] * direction[k];
    }
    for (size_t k = 0; k < 3; ++k) {
        det += p[k] * e1[k];
        u += s[k] * p[k];
        v += direction[k] * q[k];
        distance += e2[k] * q[k];
    }
    *unsafe = false;
    if (n2 < 1e-24L * l2 * l2) {
        return false;
    }
    if (det * det < 1e-12L * n2 * d2) {
        *unsafe = true;
        return false;
    }
    u /= det, v /= det, distance /= det;
    const long double margin = 1e-7L, least = fminl(fminl(u, v), 1 - u - v);
    *unsafe = least > -margin && least < margin;
    *hit = (pci_hit){.triangle = (uint32_t)t,
                     .distance = (double)distance,
                     .barycentric = {(double)(1 - u - v), (double)u, (double)v},
                     .back_face = det < 0};
    return least >= 0;
}

static bool odd_back_faces(void *user, const pci_hit *hit) {
    (void)user;
    return hit->back_face && hit->triangle % 2 == 1;
}

static void cast_equals_reference(void **state) {
    (void)state;
    static const struct { double size, offset; } places[] = {{1.0, 0.0}, {1e-3, 5.0}, {1e4, -3e4}};
    pc_context *context = test_context(1);
    for (size_t place = 0; place < sizeof(places) / sizeof(places[0]); ++place) {
        const double size = places[place].size, offset = places[place].offset;
        pc_mesh soup = random_soup(context, 200, 20 + place, size, offset);
        pci_bvh *bvh = NULL;
        assert_ok(context, pci_bvh_create(context, "test", &soup, &bvh));
        size_t compared = 0, hits = 0;
        for (size_t i = 0; i < 3000; ++i) {
            double origin[3], direction[3];
            const double spread = i % 5 == 0 ? 50.0 : 1.0;
            for (size_t k = 0; k < 3; ++k) {
                origin[k] = offset + size * (0.5 + spread * (pci_random(6, i, k) - 0.5));
                const double target = offset + size * pci_random(6, i, 3 + k);
                direction[k] = (target - origin[k]) * 3.0;
            }
            if (i % 5 == 1) { // along an axis
                direction[i % 3] = direction[(i + 1) % 3] = 0.0;
            }
            const double near = i % 2 == 0 ? 0.0 : 0.05, far = i % 4 < 2 ? (double)INFINITY : 0.2;
            const pci_hit_filter filter = i % 3 == 0 ? odd_back_faces : NULL;
            pci_hit expected = {.triangle = PC_INVALID_INDEX, .distance = INFINITY};
            bool any_unsafe = false;
            for (size_t t = 0; t < soup.triangle_count; ++t) {
                pci_hit hit = {0};
                bool unsafe = false;
                if (reference_hit(&soup, t, origin, direction, &hit, &unsafe) && !unsafe) {
                    any_unsafe |= fabs(hit.distance - near) < 1e-9;
                    any_unsafe |= fabs(hit.distance - far) < 1e-9;
                    if (hit.distance >= near && hit.distance <= far &&
                        hit.distance < expected.distance &&
                        (filter == NULL || filter(NULL, &hit))) {
                        expected = hit;
                    }
                }
                any_unsafe |= unsafe;
            }
            if (any_unsafe) {
                continue;
            }
            bvh->kernel = i % 4 == 0 ? &pci_bvh_generic : pci_bvh_best_kernel();
            const pci_hit found = pci_bvh_cast(bvh, origin, direction, near, far, filter, NULL);
            ++compared;
            assert_int_equal(found.triangle, expected.triangle);
            if (found.triangle != PC_INVALID_INDEX) {
                ++hits;
                const double tolerance = 1e-15 * (fabs(offset) / size + spread) * 1e3;
                assert_close(found.distance, expected.distance, tolerance);
                assert_int_equal(found.back_face, expected.back_face);
                for (size_t k = 0; k < 3; ++k) {
                    assert_close(found.barycentric[k], expected.barycentric[k], 1e3 * tolerance);
                }
            }
        }
        assert_true(compared > 2000);
        assert_true(hits > 500);
        pci_bvh_destroy(context, bvh);
        pc_mesh_free(context, &soup);
    }
    pc_context_destroy(context);
}

// Rays from inside a closed mesh that aim exactly at its vertices and at points on its edges.
static void no_ray_slips_out_of_a_closed_mesh(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    static const uint32_t octahedron[24] = {0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4,
                                            2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5};
    double positions[18] = {1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 1, 0, 0, -1};
    uint32_t triangles[24];
    memcpy(triangles, octahedron, sizeof(triangles));
    for (size_t i = 0; i < 18; ++i) {
        positions[i] += 0.01 * pci_random(8, i, 0);
    }
    const pc_mesh mesh = {6, positions, 8, triangles};
    pci_bvh *bvh = NULL;
    assert_ok(context, pci_bvh_create(context, "test", &mesh, &bvh));
    for (size_t i = 0; i < 20000; ++i) {
        const uint32_t *corners = &octahedron[3 * (i % 8)];
        const double s = i % 5 == 0 ? 0.0 : pci_random(9, i, 3);
        double origin[3], direction[3];
        for (size_t k = 0; k < 3; ++k) {
            origin[k] = 0.4 * (pci_random(9, i, k) - 0.5);
            const double target =
                (1.0 - s) * positions[3 * corners[0] + k] + s * positions[3 * corners[1] + k];
            direction[k] = target - origin[k];
        }
        const pci_hit hit = pci_bvh_cast(bvh, origin, direction, 0.0, INFINITY, NULL, NULL);
        assert_int_not_equal(hit.triangle, PC_INVALID_INDEX);
        assert_close(hit.distance, 1.0, 1e-12);
        assert_true(hit.back_face);
    }
    pci_bvh_destroy(context, bvh);
    pc_context_destroy(context);
}

static void cast_survives_strange_rays(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh soup = random_soup(context, 50, 9, 1.0, 0.0);
    pci_bvh *bvh = NULL;
    assert_ok(context, pci_bvh_create(context, "test", &soup, &bvh));
    const double origin[3] = {0.5, 0.5, 0.5}, zero[3] = {0}, up[3] = {0, 0, 1};
    const double bad[3] = {0, NAN, 1}, infinite[3] = {INFINITY, 0, 1};
    assert_int_equal(pci_bvh_cast(bvh, origin, zero, 0, INFINITY, NULL, NULL).triangle,
                     PC_INVALID_INDEX);
    assert_int_equal(pci_bvh_cast(bvh, origin, bad, 0, INFINITY, NULL, NULL).triangle,
                     PC_INVALID_INDEX);
    assert_int_equal(pci_bvh_cast(bvh, origin, infinite, 0, INFINITY, NULL, NULL).triangle,
                     PC_INVALID_INDEX);
    assert_int_equal(pci_bvh_cast(bvh, bad, up, 0, INFINITY, NULL, NULL).triangle,
                     PC_INVALID_INDEX);
    assert_int_equal(pci_bvh_cast(bvh, origin, up, 1, 0, NULL, NULL).triangle, PC_INVALID_INDEX);
    // Any size of origin and direction comes back, if only with a miss.
    for (int exponent = -320; exponent <= 308; exponent += 4) {
        const double size = pow(10.0, exponent);
        const double remote[3] = {-size, -0.3 * size, size},
                     long_way[3] = {size, 0.3 * size, -size};
        (void)pci_bvh_cast(bvh, remote, long_way, 0, INFINITY, NULL, NULL);
        (void)pci_bvh_cast(bvh, remote, up, -INFINITY, size, NULL, NULL);
        (void)pci_bvh_cast(bvh, origin, long_way, -size, size, NULL, NULL);
        (void)pci_bvh_closest(bvh, remote, size);
    }
    // `near` below zero looks back along the ray.
    const double above[3] = {corner(&soup, 0, 0)[0] * 0.5 + corner(&soup, 0, 1)[0] * 0.25 +
                                 corner(&soup, 0, 2)[0] * 0.25,
                             corner(&soup, 0, 0)[1] * 0.5 + corner(&soup, 0, 1)[1] * 0.25 +
                                 corner(&soup, 0, 2)[1] * 0.25,
                             100.0};
    const pci_hit hit = pci_bvh_cast(bvh, above, up, -INFINITY, INFINITY, NULL, NULL);
    assert_int_not_equal(hit.triangle, PC_INVALID_INDEX);
    assert_true(hit.distance < -98.0 && hit.distance > -102.0);
    pci_bvh_destroy(context, bvh);
    pc_mesh_free(context, &soup);
    pc_context_destroy(context);
}

// ---- threads, errors ----------------------------------------------------------------------------

typedef struct query_batch {
    const pci_bvh *bvh;
    pci_closest *closest;
    pci_hit *hits;
} query_batch;

static void query_piece(void *user, size_t begin, size_t end, uint32_t worker) {
    (void)worker;
    const query_batch *batch = user;
    for (size_t i = begin; i < end; ++i) {
        double point[3], direction[3];
        for (size_t k = 0; k < 3; ++k) {
            point[k] = pci_random(10, i, k);
            direction[k] = pci_random(10, i, 3 + k) - 0.5;
        }
        batch->closest[i] = pci_bvh_closest(batch->bvh, point, INFINITY);
        batch->hits[i] = pci_bvh_cast(batch->bvh, point, direction, 0.0, INFINITY, NULL, NULL);
    }
}

static void queries_do_not_depend_on_threads(void **state) {
    (void)state;
    enum { COUNT = 2000 };
    static const uint32_t thread_counts[] = {1, 2, 3, 8};
    pci_closest *first_closest = NULL;
    pci_hit *first_hits = NULL;
    pc_context *owner = test_context(1);
    for (size_t i = 0; i < 4; ++i) {
        pc_context *context = test_context(thread_counts[i]);
        pc_mesh soup = random_soup(context, 500, 11, 1.0, 0.0);
        pci_bvh *bvh = NULL;
        assert_ok(context, pci_bvh_create(context, "test", &soup, &bvh));
        const query_batch batch = {.bvh = bvh,
                                   .closest = PCI_ALLOCATE(owner, pci_closest, COUNT),
                                   .hits = PCI_ALLOCATE(owner, pci_hit, COUNT)};
        pci_parallel_for(context, COUNT, 16, query_piece, (void *)(uintptr_t)&batch);
        if (i == 0) {
            first_closest = batch.closest, first_hits = batch.hits;
        } else {
            for (size_t q = 0; q < COUNT; ++q) {
                assert_int_equal(batch.closest[q].triangle, first_closest[q].triangle);
                assert_true(batch.closest[q].distance == first_closest[q].distance);
                assert_int_equal(batch.hits[q].triangle, first_hits[q].triangle);
                assert_true(batch.hits[q].distance == first_hits[q].distance);
            }
            pc_release(owner, batch.closest);
            pc_release(owner, batch.hits);
        }
        pci_bvh_destroy(context, bvh);
        pc_mesh_free(context, &soup);
        pc_context_destroy(context);
    }
    pc_release(owner, first_closest);
    pc_release(owner, first_hits);
    pc_context_destroy(owner);
}

static void degenerate_meshes_work(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    const pc_mesh empty = {0};
    pci_bvh *bvh = NULL;
    const double origin[3] = {1, 2, 2}, down[3] = {0, 0, -1};
    assert_ok(context, pci_bvh_create(context, "test", &empty, &bvh));
    assert_int_equal(pci_bvh_closest(bvh, origin, INFINITY).triangle, PC_INVALID_INDEX);
    assert_int_equal(pci_bvh_cast(bvh, origin, down, 0, INFINITY, NULL, NULL).triangle,
                     PC_INVALID_INDEX);
    pci_bvh_destroy(context, bvh);

    double positions[3] = {0};
    uint32_t triangles[3] = {0};
    const pc_mesh point = {1, positions, 1, triangles};
    assert_ok(context, pci_bvh_create(context, "test", &point, &bvh));
    assert_close(pci_bvh_closest(bvh, origin, INFINITY).distance, 3.0, 0.0);
    assert_int_equal(pci_bvh_closest(bvh, origin, 2.9).triangle, PC_INVALID_INDEX);
    pci_bvh_destroy(context, bvh);
    pci_bvh_destroy(context, NULL);

    positions[1] = NAN;
    assert_int_equal(pci_bvh_create(context, "test", &point, &bvh), PC_ERROR_NUMERICAL);
    assert_null(bvh);
    pc_context_destroy(context);
}

// Triangles around one edge, whose boxes all hold it: no tree tells them apart.
static void crowded_meshes_are_refused(void **state) {
    (void)state;
    enum { most = 4000 };
    pc_context *context = test_context(1);
    double *positions = PCI_ALLOCATE(context, double, 3 * (most + 2));
    uint32_t *triangles = PCI_ALLOCATE(context, uint32_t, 3 * most);
    assert_true(positions != NULL && triangles != NULL);
    positions[4] = 1.0;
    for (uint32_t t = 0; t < most; ++t) {
        const double angle = 1.5 * pci_random(41, t, 0);
        const double apex[3] = {cos(angle), 0.5, sin(angle)};
        memcpy(&positions[3 * (t + 2)], apex, sizeof(apex));
        const uint32_t corners[3] = {0, 1, t + 2};
        memcpy(&triangles[3 * t], corners, sizeof(corners));
    }
    pci_bvh *bvh = NULL;
    const pc_mesh few = {most + 2, positions, most / 4, triangles};
    assert_ok(context, pci_bvh_create(context, "test", &few, &bvh));
    pci_bvh_destroy(context, bvh);
    const pc_mesh crowd = {most + 2, positions, most, triangles};
    assert_int_equal(pci_bvh_create(context, "test", &crowd, &bvh), PC_ERROR_TOO_LARGE);
    assert_null(bvh);
    // The same one triangle instead is no crowd, nor are small ones.
    for (uint32_t t = 0; t < most; ++t) {
        triangles[3 * t + 2] = 2;
    }
    assert_ok(context, pci_bvh_create(context, "test", &crowd, &bvh));
    pci_bvh_destroy(context, bvh);
    pc_mesh soup = random_soup(context, most, 42, 1.0, 0.0);
    assert_ok(context, pci_bvh_create(context, "test", &soup, &bvh));
    pci_bvh_destroy(context, bvh);
    pc_mesh_free(context, &soup);
    pc_release(context, positions);
    pc_release(context, triangles);
    pc_context_destroy(context);
}

// A shared mesh has one tree, whoever asks and releases; other meshes have their own.
static void shared_trees_are_built_once(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    double positions[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    uint32_t triangles[3] = {0, 1, 2};
    const pc_mesh mesh = {3, positions, 1, triangles}, other = mesh;
    const double point[3] = {0.25, 0.25, 2};
    pci_bvh *first, *second, *apart;
    pci_bvh_share(context, &mesh);
    assert_ok(context, pci_bvh_create(context, "test", &mesh, &first));
    pci_bvh_destroy(context, first);
    assert_ok(context, pci_bvh_create(context, "test", &mesh, &second));
    assert_ok(context, pci_bvh_create(context, "test", &other, &apart));
    assert_ptr_equal(first, second);
    assert_ptr_not_equal(apart, second);
    assert_close(pci_bvh_closest(second, point, INFINITY).distance, 2.0, 0.0);
    pci_bvh_destroy(context, second);
    // Its end is that of the sharing; what is created then belongs to the caller again.
    pci_bvh_share(context, NULL);
    positions[2] = positions[5] = positions[8] = 1.0;
    assert_ok(context, pci_bvh_create(context, "test", &mesh, &second));
    assert_close(pci_bvh_closest(second, point, INFINITY).distance, 1.0, 0.0);
    pci_bvh_destroy(context, second);
    pci_bvh_destroy(context, apart);
    pc_context_destroy(context);
}

// Other indices and the other side of the same triangles: answers are those of a tree of their own,
// also after the sharing has ended.
static void same_triangles_borrow_the_shared_tree(void **state) {
    (void)state;
    pc_context *context = test_context(1);
    pc_mesh sphere = test_sphere(context, 3), turned = test_sphere(context, 3);
    for (size_t t = 0; t < turned.triangle_count; ++t) {
        uint32_t *corner = &turned.triangles[3 * t], second = corner[1];
        corner[1] = corner[2];
        corner[2] = second;
    }
    for (size_t moved = 0; moved < 2; ++moved) {
        pci_bvh *borrowed, *own;
        turned.positions[0] += 0.25 * (double)moved;
        assert_false(pci_bvh_shares(context));
        assert_ok(context, pci_bvh_create(context, "test", &turned, &own));
        pci_bvh_share(context, &sphere);
        assert_true(pci_bvh_shares(context));
        assert_ok(context, pci_bvh_create(context, "test", &turned, &borrowed));
        for (uint64_t i = 0; i < 200; ++i) {
            double point[3];
            for (uint64_t k = 0; k < 3; ++k) {
                point[k] = 3.0 * pci_random(7, i, k) - 1.5;
            }
            const pci_closest a = pci_bvh_closest(borrowed, point, INFINITY);
            const pci_closest b = pci_bvh_closest(own, point, INFINITY);
            assert_memory_equal(&a, &b, sizeof(a));
            const pci_hit hit =
                pci_bvh_cast(borrowed, point, (double[3]){0, 0, 1}, 0.0, 9.0, NULL, NULL);
            const pci_hit other =
                pci_bvh_cast(own, point, (double[3]){0, 0, 1}, 0.0, 9.0, NULL, NULL);
            assert_int_equal(hit.triangle, other.triangle);
            assert_int_equal(hit.back_face, other.back_face);
        }
        pci_bvh_destroy(context, borrowed);
        pci_bvh_share(context, NULL);
        pci_bvh_destroy(context, own);
    }
    pc_mesh_free(context, &sphere);
    pc_mesh_free(context, &turned);
    pc_context_destroy(context);
}

static void *no_memory(void *user, size_t size) { return *(bool *)user ? NULL : malloc(size); }

static void plain_free(void *user, void *memory) {
    (void)user;
    free(memory);
}

static void lack_of_memory_is_reported(void **state) {
    (void)state;
    bool empty = false;
    const pc_context_options options = {.allocator = {no_memory, plain_free, &empty}, .threads = 1};
    pc_context *context = NULL;
    assert_int_equal(pc_context_create(&options, &context), PC_OK);
    const pc_mesh mesh = {0};
    pci_bvh *bvh = NULL;
    empty = true;
    assert_int_equal(pci_bvh_create(context, "test", &mesh, &bvh), PC_ERROR_OUT_OF_MEMORY);
    assert_null(bvh);
    pc_context_destroy(context);
}

static bool count_and_refuse(void *user, const char *stage, double fraction) {
    assert_string_equal(stage, "running");
    assert_close(fraction, 0.0, 0.0);
    ++*(int *)user;
    return false;
}

// A context inside the stage "running", whose user refuses and has not been asked for a while.
static pc_context *impatient_context(int *calls) {
    static const pc_field no_fields[1];
    static const pc_record no_options = {.fields = no_fields};
    const pc_context_options options = {.threads = 2, .progress = count_and_refuse, .user = calls};
    pc_context *context = NULL;
    int nothing = 0;
    assert_int_equal(pc_context_create(&options, &context), PC_OK);
    assert_ok(context, pci_begin_stage(context, "running", &no_options, &nothing, &nothing));
    for (const double start = pci_clock_seconds(); pci_clock_seconds() < start + 0.11;) {
    }
    return context;
}

// The user can cancel while the tree is built, but is not asked on behalf of another stage.
static void building_can_be_cancelled(void **state) {
    (void)state;
    pc_context *owner = test_context(1);
    pc_mesh mesh = random_soup(owner, 40000, 3, 1.0, 0.0);
    int calls = 0;
    pc_context *context = impatient_context(&calls);
    pci_bvh *bvh = NULL;
    assert_ok(context, pci_bvh_create(context, "other", &mesh, &bvh));
    pci_bvh_destroy(context, bvh);
    assert_int_equal(calls, 0);
    assert_int_equal(pci_bvh_create(context, "running", &mesh, &bvh), PC_ERROR_CANCELLED);
    assert_int_equal(calls, 1);
    assert_null(bvh);
    pc_context_destroy(context);
    pc_mesh_free(owner, &mesh);
    pc_context_destroy(owner);
}

static void watched_topology_can_be_cancelled(void **state) {
    (void)state;
    pc_context *owner = test_context(1);
    pc_mesh mesh = random_soup(owner, 1000, 3, 1.0, 0.0);
    int calls = 0;
    pc_context *context = impatient_context(&calls);
    pci_scratch scratch = pci_scratch_begin(context);
    pci_topology topology;
    assert_true(pci_topology_build(&scratch, &mesh, &topology));
    assert_int_equal(calls, 0);
    assert_false(pci_topology_build_watched(&scratch, &mesh, &topology));
    assert_int_equal(calls, 1);
    assert_false(scratch.failed);
    assert_int_equal(pci_fail_memory(context, "running"), PC_ERROR_CANCELLED);
    pci_scratch_end(&scratch);
    pc_context_destroy(context);
    pc_mesh_free(owner, &mesh);
    pc_context_destroy(owner);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(triangle_distance_knows_its_regions),
        cmocka_unit_test(triangle_distance_is_the_minimum),
        cmocka_unit_test(triangle_distances_agree),
        cmocka_unit_test(closest_equals_brute_force),
        cmocka_unit_test(moving_points_find_the_same),
        cmocka_unit_test(hints_change_no_answer),
        cmocka_unit_test(closest_survives_strange_points),
        cmocka_unit_test(cast_equals_reference),
        cmocka_unit_test(no_ray_slips_out_of_a_closed_mesh),
        cmocka_unit_test(cast_survives_strange_rays),
        cmocka_unit_test(queries_do_not_depend_on_threads),
        cmocka_unit_test(degenerate_meshes_work),
        cmocka_unit_test(crowded_meshes_are_refused),
        cmocka_unit_test(shared_trees_are_built_once),
        cmocka_unit_test(same_triangles_borrow_the_shared_tree),
        cmocka_unit_test(lack_of_memory_is_reported),
        cmocka_unit_test(building_can_be_cancelled),
        cmocka_unit_test(watched_topology_can_be_cancelled),
    };
    return cmocka_run_group_tests_name("bvh", tests, NULL, NULL);
}
