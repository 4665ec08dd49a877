/// The body's skin: where a garment of a skinned character keeps its place on the body, and where
/// it passes over to the proxy.
///
/// A vertex of the visual mesh goes to s p + (1 - s) b, p where the proxy takes it (equation (6)),
/// b where the character's joints take it by linear blend skinning, s its share of the proxy: 0 at
/// collars and belts that should sit still on the body, 1 where the cloth is free. Pinned vertices
/// of the proxy follow the same joints (scenario.h), so both agree where one passes into the other.
///
/// Shares come from the distance to the nearest pinned vertex of the proxy, 0 there and 1 from
/// `body_blend` of the visual mesh's diagonal on, smooth in between; or from a painted channel.
///
/// A garment without weights of its own takes them from the body. A vertex matches when the closest
/// point of the body is within 5 % of the garment's diagonal and faces its way or the opposite way
/// within 45 degrees; it takes the weights there. The others are filled in, island by island (parts
/// of the garment that no triangle connects): harmonic functions between the matches. Islands
/// without any match are stiff and follow the body's point nearest to them.
#ifndef PROXYCLOTH_BODY_H
#define PROXYCLOTH_BODY_H

#include "proxycloth/character.h"
#include "proxycloth/skin.h"

#ifdef __cplusplus
extern "C" {
#endif

/// What the visual mesh takes from the character.
typedef struct pc_body_skin {
    size_t vertex_count; ///< visual vertices; 0: nothing, all shares are 1
    uint32_t *joints;    ///< #V by 4, joints of the character
    double *weights;     ///< #V by 4, falling, sum 1, or all 0 where the share is 1
    double *shares;      ///< #V, of the proxy, 0..1
} pc_body_skin;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_body_skin_free(pc_context *context, pc_body_skin *skin);

typedef struct pc_body_report {
    uint64_t own_weights; ///< vertices with weights from the input file
    uint64_t matched;     ///< vertices with weights from a matching point of the body
    uint64_t filled;      ///< vertices with weights from their neighbours
    uint64_t rigid;       ///< vertices of islands without a match
} pc_body_report;

extern const pc_record pc_body_report_record;

/// @param[in]  options  of these `body_blend` and `body_channel` count; NULL for the defaults,
///                      under which nothing follows the body.
/// @param[out] skin     zeroed on entry.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT; PC_ERROR_INVALID_OPTIONS (a blend is asked for, but
///         neither garment nor body have weights, or nothing is pinned, or there are no vertex
///         colors); PC_ERROR_OUT_OF_MEMORY; PC_ERROR_DEPENDENCY (Embree); PC_ERROR_NUMERICAL;
///         PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_body_skin_create(pc_context *context, const pc_visual *visual,
                                           const pc_character *character, const pc_mesh *proxy,
                                           const pc_motion *motion, const pc_skin_options *options,
                                           pc_body_skin *skin, pc_body_report *report);

#ifdef __cplusplus
}
#endif
#endif
