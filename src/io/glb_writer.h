// A binary glTF file under construction: its buffer (glb_writer.c), and the parts from which glb.c
// puts it together.
#ifndef PCI_GLB_WRITER_H
#define PCI_GLB_WRITER_H

#include "io/json.h"
#include "proxycloth/body.h"
#include "proxycloth/pipeline.h"

enum {
    GL_UNSIGNED_BYTE = 5121,
    GL_UNSIGNED_SHORT = 5123,
    GL_UNSIGNED_INT = 5125,
    GL_FLOAT = 5126,
    GL_ARRAY_BUFFER = 34962,
    GL_ELEMENT_ARRAY_BUFFER = 34963
};
#define PCI_GLB_NAME_LIMIT 40 // bytes; Blender cuts names at 63

// The two chunks under construction.
typedef struct pci_glb {
    pc_context *context;
    const pc_asset *asset;
    pci_scratch scratch;
    pci_json json;
    cJSON *accessors, *views, *meshes, *materials;
    uint32_t accessor_count, view_count, material_count;
    unsigned char *bytes;
    size_t size, capacity;
    char name[PCI_GLB_NAME_LIMIT + 1]; // prefix of all node names
    pc_body_skin body;                 // empty: the garment follows the proxy alone
} pci_glb;

// Whether memory ran out; what is built from then on is of no use.
static inline bool pci_glb_failed(const pci_glb *glb) {
    return glb->scratch.failed || glb->json.failed;
}

// Appends a buffer view, aligned to 4 bytes. The memory stays valid until the next view; NULL when
// memory ran out.
void *pci_glb_add_view(pci_glb *glb, size_t size, int target);
// Describes a part of the last view. Returns the accessor's JSON; its index is accessor_count - 1.
cJSON *pci_glb_add_accessor(pci_glb *glb, size_t offset, int component, size_t count,
                            const char *type);
// A view of its own for `count` tuples of floats.
float *pci_glb_add_floats(pci_glb *glb, size_t count, uint32_t tuple, int target, cJSON **accessor);
// The same for an attribute of a primitive.
float *pci_glb_add_attribute(pci_glb *glb, cJSON *attributes, const char *name, size_t count,
                             uint32_t tuple);
// The least and the largest value of each of the tuple's elements.
void pci_glb_add_limits(pci_glb *glb, cJSON *accessor, const float *values, size_t count,
                        size_t tuple);

// ---- skinning weights (glb_weights.c) -----------------------------------------------------------

// Weights as engines take them: falling, no joint twice, unused slots joint 0 with weight 0. As
// floats the sum is as close to 1 as floats allow, as integers it is exactly `whole`.
typedef struct pci_glb_weights {
    uint32_t slots; // multiple of 4
    uint32_t whole; // what stands for 1: 255, 65535, or 0 for floats
    uint32_t *joints;
    float *weights;
} pci_glb_weights;

// What stands for a weight of 1 in the file, by the asset's options.
uint32_t pci_glb_weight_whole(const pci_glb *glb);
// Fills all but `whole`, from scratch.
void pci_glb_pack_weights(pci_glb *glb, const pc_skin *skin, pci_glb_weights *weights);
// JOINTS_n and WEIGHTS_n for the vertices `rows` (NULL: all in order) of the packed weights.
void pci_glb_add_weights(pci_glb *glb, cJSON *attributes, const pci_glb_weights *weights,
                         const uint32_t *rows, size_t count);

// ---- meshes (glb_mesh.c) ------------------------------------------------------------------------

// The visual mesh, a primitive for each material.
void pci_glb_add_visual_mesh(pci_glb *glb);
// The proxy mesh: vertex i follows joint i alone.
void pci_glb_add_proxy_mesh(pci_glb *glb);

// ---- the skeleton of the character (glb_body.c); nothing where `body` is empty ------------------

// Joints of the skin: those of the proxy, then those of the skeleton.
size_t pci_glb_joint_count(const pci_glb *glb);
// Names the nodes of joints without parent as children; the skeleton's nodes begin at `first`.
void pci_glb_add_body_roots(pci_glb *glb, cJSON *children, size_t first);
void pci_glb_add_body_nodes(pci_glb *glb, cJSON *nodes, size_t first);
// Channels of the scenario's clip; `sampler` is the index of the next one.
void pci_glb_add_body_channels(pci_glb *glb, uint32_t input, cJSON *channels, cJSON *samplers,
                               size_t sampler, size_t first);

#endif
