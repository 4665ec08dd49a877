// The joints of a character at a time.
#ifndef PCI_POSE_H
#define PCI_POSE_H

#include "core/core.h"
#include "proxycloth/character.h"
#include "proxycloth/scenario.h"

// From the rest pose to where something is now.
typedef struct pci_map {
    double m[12]; // 3 rows of 4
} pci_map;

void pci_map_apply(const pci_map *map, const double point[3], double out[3]);
// Inverse of an affine map; false and unchanged where it has none.
bool pci_map_invert(const pci_map *map, pci_map *out);

// What moves pinned vertices and colliders.
typedef struct pci_poses {
    const pc_character *character;
    const pc_attachment *attachment;
    double scale; // of lengths: unit of the maps per unit of the file
    uint32_t first_pose, pose_count;
    double rate;
    pci_map *maps; // #joints, of the time given last
} pci_poses;

// Looks up the clip of the attachment, if it has one; PC_ERROR_INVALID_OPTIONS when there is none
// of this name. `character` may be NULL: no joints.
PC_NODISCARD pc_status pci_poses_begin(pci_scratch *scratch, const char *stage,
                                       const pc_character *character,
                                       const pc_attachment *attachment, double scale,
                                       pci_poses *poses);
// Sets the maps for a time in s; negative times lead from the rest pose to the clip's start.
void pci_poses_set(pci_poses *poses, double time);

#endif
