// Closest points and rays on a triangle mesh. A tree that Embree builds proposes candidates in
// float, every decision is made in double, ties go to the smaller triangle index, so results do not
// depend on the tree or the instruction set. Queries are thread-safe and allocate nothing.
#ifndef PCI_BVH_H
#define PCI_BVH_H

#include "core/core.h"
#include "geometry/triangle_distance.h"
#include "proxycloth/mesh.h"

typedef struct pci_bvh pci_bvh;

// The mesh must stay alive and unchanged. Degenerate triangles count as segments or points. Can be
// cancelled, by the user of the running stage when that is `stage`. PC_ERROR_TOO_LARGE where the
// triangles lie in each other's boxes so much that most searches would visit thousands.
PC_NODISCARD pc_status pci_bvh_create(pc_context *context, const char *stage, const pc_mesh *mesh,
                                      pci_bvh **bvh);
void pci_bvh_destroy(pc_context *context, pci_bvh *bvh); // NULL is accepted

// From now on one tree of this mesh, built when it is first needed, serves all that create one of
// it or of a mesh with the same triangles in the same order, until this is called with another mesh
// or NULL; those that have one must have destroyed it by then. Between the calls the mesh must stay
// alive and unchanged.
void pci_bvh_share(pc_context *context, const pc_mesh *mesh);
bool pci_bvh_shares(const pc_context *context); // whether there is such a mesh

typedef struct pci_closest {
    uint32_t triangle; // PC_INVALID_INDEX: nothing within the radius
    double point[3];
    double barycentric[3];
    double distance;
} pci_closest;

// The closest point of the mesh within `radius` (INFINITY allowed).
pci_closest pci_bvh_closest(const pci_bvh *bvh, const double point[3], double radius);

// Whether any point of the mesh is within `radius`; quicker, since the first one will do.
bool pci_bvh_within(const pci_bvh *bvh, const double point[3], double radius);

// The same, but `hint`, a triangle or PC_INVALID_INDEX, is asked before any other, and becomes the
// one that was found. Among neighbours it mostly settles the matter, and where a hundred thousand
// boxes hold the point, all of which a search visits, nothing else is quick.
bool pci_bvh_within_near(const pci_bvh *bvh, const double point[3], double radius, uint32_t *hint);

// The closest point within any radius, but much quicker where triangle `hint` is near: a search
// among neighbours hands on what it found last. PC_INVALID_INDEX: no idea.
pci_closest pci_bvh_closest_near(const pci_bvh *bvh, const double point[3], uint32_t hint);

// A point of a mesh.
typedef struct pci_place {
    uint32_t triangle;
    double barycentric[3];
} pci_place;

// The closest point of `mesh` for every vertex of `from`, #V.
// PC_OK; PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY; PC_ERROR_TOO_LARGE; PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pci_closest_points(pc_context *context, const char *stage,
                                          const pc_mesh *from, const pc_mesh *mesh,
                                          pci_place *closest);

// Collects the triangles within `radius`, in no particular order. Returns their number, or
// capacity + 1 when there are more than fit; then `triangles` holds some of them.
size_t pci_bvh_collect(const pci_bvh *bvh, const double point[3], double radius, size_t capacity,
                       uint32_t *triangles);

// The same, with `radius` halved, up to eight times, until they fit; 0 when they never do.
size_t pci_bvh_collect_fitting(const pci_bvh *bvh, const double point[3], double *radius,
                               size_t capacity, uint32_t *triangles);

enum { PCI_SURROUNDINGS = 8 };

// The triangles around a point; zeroed before the first query.
typedef struct pci_surroundings {
    double centre[3], radius; // all within are listed, with their distances from the centre
    double distances[PCI_SURROUNDINGS];
    uint32_t triangles[PCI_SURROUNDINGS];
    uint32_t count;
} pci_surroundings;

// The closest point within `bound`, where there must be one, of a point that moves a little from
// query to query: as long as it and the closest triangle stay in the ball that was searched, only
// the triangles of that are looked at. New balls are larger by `margin` than they need to be.
pci_closest pci_bvh_closest_moving(const pci_bvh *bvh, const double point[3], double bound,
                                   double margin, pci_surroundings *around);

typedef struct pci_hit {
    uint32_t triangle; // PC_INVALID_INDEX: no hit
    double distance;   // along the direction, in units of its length
    double barycentric[3];
    bool back_face; // the ray leaves through the front, direction . normal > 0
} pci_hit;

// Whether a hit counts. Called from the querying thread.
typedef bool (*pci_hit_filter)(void *user, const pci_hit *hit);

// First accepted hit with near <= distance <= far. `filter` may be NULL.
pci_hit pci_bvh_cast(const pci_bvh *bvh, const double origin[3], const double direction[3],
                     double near, double far, pci_hit_filter filter, void *user);

// Whether triangle t comes within `radius` of a point: for a few points, a tree is not worth while.
bool pci_triangle_within(const pc_mesh *mesh, size_t t, const double point[3], double radius);

#endif
