// What an asset holds, as data: every array and number of every stage in one table that saving,
// loading and checking share.
#ifndef PCI_ASSET_TABLE_H
#define PCI_ASSET_TABLE_H

#include "core/core.h"
#include "proxycloth/pipeline.h"

// Groups of the file: the visual mesh, then the stages.
#define PCI_GROUP_COUNT (PC_STAGE_COUNT + 1)

// "visual" or the stage's name.
const char *pci_group_name(int group);

typedef enum pci_element {
    PCI_ELEMENT_F64,
    PCI_ELEMENT_F32,
    PCI_ELEMENT_U64,
    PCI_ELEMENT_U32,
    PCI_ELEMENT_U8,
    PCI_ELEMENT_I8,
    PCI_ELEMENT_COUNT
} pci_element;

// Numbers of elements that arrays share.
typedef enum pci_count {
    PCI_COUNT_NONE = 0,
    PCI_COUNT_SURFACE_VERTICES,
    PCI_COUNT_SURFACE_TRIANGLES,
    PCI_COUNT_CORNERS,
    PCI_COUNT_MATERIALS,
    PCI_COUNT_PARTS,
    PCI_COUNT_JOINTS,
    PCI_COUNT_CLIPS,
    PCI_COUNT_POSES,
    PCI_COUNT_BODY_VERTICES,
    PCI_COUNT_BODY_TRIANGLES,
    PCI_COUNT_BODY_PARTS,
    PCI_COUNT_SAMPLES,
    PCI_COUNT_ISOSURFACE_VERTICES,
    PCI_COUNT_ISOSURFACE_TRIANGLES,
    PCI_COUNT_PROJECTED_VERTICES,
    PCI_COUNT_PROJECTED_TRIANGLES,
    PCI_COUNT_GRAPH_VERTICES,
    PCI_COUNT_EDGES,
    PCI_COUNT_OPPOSITES,
    PCI_COUNT_LABELS,
    PCI_COUNT_LAYER_VERTICES,
    PCI_COUNT_LAYER_TRIANGLES,
    PCI_COUNT_PROXY_VERTICES,
    PCI_COUNT_PROXY_TRIANGLES,
    PCI_COUNT_FRAMES,
    PCI_COUNT_MOTION_VERTICES,
    PCI_COUNT_SKIN_VERTICES,
    PCI_COUNT_INFLUENCES,
    PCI_COUNT_COUNT
} pci_count;

size_t pci_count_get(const pc_asset *asset, pci_count count);
void pci_count_set(pc_asset *asset, pci_count count, size_t value); // below 2^31

typedef enum pci_values {
    PCI_VALUES_FINITE,
    PCI_VALUES_NOT_NAN, // infinity allowed
    PCI_VALUES_INDEX,   // below the count `limit`
    PCI_VALUES_FLAG,    // 0 or 1
    PCI_VALUES_SIGN,    // -1, 0, 1
    PCI_VALUES_SHARE,   // 0..1, float
    PCI_VALUES_NAME,    // rows of bytes, each ends with 0
    PCI_VALUES_ANY      // checked elsewhere
} pci_values;

typedef struct pci_array_info {
    int group;
    const char *name;
    pci_element element;
    pci_count rows;
    pci_count columns; // or PCI_COUNT_NONE
    uint32_t tuple;    // numbers per element; 1: the dimension is left out
    size_t offset;     // of the pointer in pc_asset
    pci_values values;
    pci_count limit;
    bool optional; // NULL is allowed
} pci_array_info;

extern const pci_array_info pci_arrays[];
extern const size_t pci_array_count;

void *pci_array_get(const pc_asset *asset, const pci_array_info *info);
void pci_array_set(pc_asset *asset, const pci_array_info *info, void *array);
size_t pci_array_shape(const pc_asset *asset, const pci_array_info *info, size_t shape[3]);

// Numbers of a stage's result that are no arrays.
typedef struct pci_scalar_info {
    int group;
    const char *name;
    pci_element element;
    uint32_t length;
    size_t offset; // in pc_asset
    bool optional; // 0 where a file lacks it
} pci_scalar_info;

extern const pci_scalar_info pci_scalars[];
extern const size_t pci_scalar_count;

// Whether counts, indices and values of the visual mesh and of all stages done fit together. When
// not, `problem` says what is wrong.
bool pci_asset_check(const pc_asset *asset, char *problem, size_t problem_size);

#endif
