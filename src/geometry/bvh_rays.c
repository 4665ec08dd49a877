// Rays.
#include "geometry/bvh.h"
#include "geometry/bvh_tree.h"

typedef struct ray_query {
    const pci_bvh *bvh;
    pci_bvh_ray line;
    double near, far;
    double entry;      // parameter where the ray in normalised space begins
    double local_rate; // distance there per unit of ours
    pci_hit_filter filter;
    void *user;
    pci_hit best;
} ray_query;

// Watertight test (Woop, Benthin, Wald 2013) in double: vertices are sheared the same way in every
// triangle, so a ray through a shared edge or vertex never slips through.
static bool intersect(const ray_query *ray, uint32_t triangle, pci_hit *hit) {
    double x[3], y[3], z[3];
    for (size_t c = 0; c < 3; ++c) {
        const double *position = pci_bvh_corner(ray->bvh->mesh, triangle, c);
        double relative[3];
        pci_sub(position, ray->line.origin, relative);
        const double along = relative[ray->line.axis[2]];
        x[c] = relative[ray->line.axis[0]] - ray->line.shear[0] * along;
        y[c] = relative[ray->line.axis[1]] - ray->line.shear[1] * along;
        z[c] = ray->line.shear[2] * along;
    }
    const double u = x[2] * y[1] - y[2] * x[1];
    const double v = x[0] * y[2] - y[0] * x[2];
    const double w = x[1] * y[0] - y[1] * x[0];
    if ((u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0)) {
        return false;
    }
    const double sum = u + v + w;
    if (sum == 0.0) {
        return false; // seen edge-on or without area
    }
    hit->triangle = triangle;
    hit->barycentric[0] = u / sum;
    hit->barycentric[1] = v / sum;
    hit->barycentric[2] = w / sum;
    hit->distance =
        hit->barycentric[0] * z[0] + hit->barycentric[1] * z[1] + hit->barycentric[2] * z[2];
    hit->back_face = sum < 0.0;
    return hit->distance >= ray->near && hit->distance <= ray->far;
}

static float strike_triangles(void *user, const pci_bvh_leaf *leaf, uint32_t met, float reach) {
    ray_query *ray = user;
    const double before = ray->best.distance;
    for (; met != 0; met &= met - 1) {
        const uint32_t triangle = leaf->triangles[__builtin_ctz(met)];
        pci_hit hit = {0};
        if (triangle != PC_INVALID_INDEX && intersect(ray, triangle, &hit) &&
            !(hit.distance > ray->best.distance) &&
            !(hit.distance == ray->best.distance && hit.triangle > ray->best.triangle) &&
            (ray->filter == NULL || ray->filter(ray->user, &hit))) {
            ray->best = hit;
        }
    }
    if (ray->best.distance == before) {
        return reach;
    }
    // Shorten the ray, with slack so that triangles at the same distance are still visited.
    const float left = (float)((ray->best.distance - ray->entry) * ray->local_rate + PCI_PADDING);
    return left < reach ? left : reach;
}

// Parameters where the ray enters and leaves the box around the mesh, enlarged by `margin`.
// Starting the float ray there keeps its coordinates small. False: the box is missed.
static bool clip_ray(const pci_bvh *bvh, const double origin[3], const double direction[3],
                     double margin, double *enter, double *leave) {
    for (size_t k = 0; k < 3; ++k) {
        const double low = bvh->minimum[k] - margin - origin[k];
        const double high = bvh->maximum[k] + margin - origin[k];
        if (direction[k] == 0.0) {
            if (low > 0.0 || high < 0.0) {
                return false;
            }
            continue;
        }
        const double a = low / direction[k], b = high / direction[k];
        *enter = fmax(*enter, fmin(a, b));
        *leave = fmin(*leave, fmax(a, b));
    }
    return *enter <= *leave;
}

pci_hit pci_bvh_cast(const pci_bvh *bvh, const double origin[3], const double direction[3],
                     double near, double far, pci_hit_filter filter, void *user) {
    const pci_hit miss = {.triangle = PC_INVALID_INDEX};
    const double length = pci_norm(direction);
    double enter = near, leave = far;
    // The margin leaves room for the slack of the float ray and for the rounding of this clipping.
    const double margin = 1e-3 / bvh->scale;
    if (!(length > 0.0) || !isfinite(length) ||
        !clip_ray(bvh, origin, direction, margin, &enter, &leave)) {
        return miss;
    }

    ray_query ray = {.bvh = bvh,
                     .line.origin = {origin[0], origin[1], origin[2]},
                     .near = near,
                     .far = far,
                     .entry = enter,
                     .local_rate = length * bvh->scale,
                     .filter = filter,
                     .user = user};
    ray.best = miss;
    ray.best.distance = INFINITY;
    size_t z = 0;
    for (size_t k = 1; k < 3; ++k) {
        z = fabs(direction[k]) > fabs(direction[z]) ? k : z;
    }
    // Swapping two axes for a negative direction keeps the winding.
    const size_t x = direction[z] < 0.0 ? (z + 2) % 3 : (z + 1) % 3;
    const size_t y = direction[z] < 0.0 ? (z + 1) % 3 : (z + 2) % 3;
    ray.line.axis[0] = x, ray.line.axis[1] = y, ray.line.axis[2] = z;
    ray.line.shear[0] = direction[x] / direction[z];
    ray.line.shear[1] = direction[y] / direction[z];
    ray.line.shear[2] = 1.0 / direction[z];

    for (size_t k = 0; k < 3; ++k) {
        const double start = (origin[k] + enter * direction[k] - bvh->centre[k]) * bvh->scale;
        ray.line.start[k] = (float)start;
        ray.line.direction[k] = (float)(direction[k] / length);
        if (!(fabs(start) < PCI_FARTHEST_POINT)) {
            return miss; // an origin so far away that nothing is left of the clipping
        }
    }
    ray.line.reach = (float)((leave - enter) * ray.local_rate + PCI_PADDING);
    if (!isfinite(ray.line.reach)) {
        return miss;
    }
    bvh->kernel->along(&bvh->tree, &ray.line, strike_triangles, &ray);
    return ray.best.triangle == PC_INVALID_INDEX ? miss : ray.best;
}
