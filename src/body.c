// What the visual mesh takes from the skeleton of its character, and how much of it.
#include "proxycloth/body.h"

#include "geometry/knn.h"
#include "geometry/topology.h"
#include "geometry/transfer.h"

static const char module[] = "body";

static const pc_field report_fields[] = {
    PCI_FIELD_REPORT(pc_body_report, own_weights, COUNT, "",
                     "Vertices with weights from the input file"),
    PCI_FIELD_REPORT(pc_body_report, matched, COUNT, "",
                     "Vertices with weights from a matching point of the body"),
    PCI_FIELD_REPORT(pc_body_report, filled, COUNT, "", "Vertices with weights from neighbours"),
    PCI_FIELD_REPORT(pc_body_report, rigid, COUNT, "", "Vertices of islands without a match"),
};
const pc_record pc_body_report_record = PCI_RECORD(report_fields, pc_body_report);

void pc_body_skin_free(pc_context *context, pc_body_skin *skin) {
    if (skin != NULL) {
        pc_release(context, skin->joints);
        pc_release(context, skin->weights);
        pc_release(context, skin->shares);
        memset(skin, 0, sizeof(*skin));
    }
}

// Weights of the input file; vertices whose corners have none keep 0. Returns how many have some.
static size_t own_weights(const pc_visual *visual, pc_body_skin *skin) {
    size_t count = 0;
    for (size_t c = 0; visual->joint_weights != NULL && c < visual->corner_count; ++c) {
        const size_t v = visual->corner_vertices[c];
        double sums[4], total = 0.0;
        for (size_t k = 0; k < 4; ++k) {
            sums[k] = (double)visual->joint_weights[4 * c + k];
            total += sums[k];
        }
        if (total > 0.0 && !(skin->weights[4 * v] > 0.0)) {
            pci_largest_weights(&visual->joints[4 * c], sums, 4, &skin->joints[4 * v],
                                &skin->weights[4 * v]);
            ++count;
        }
    }
    return count;
}

static pc_status share_by_distance(pc_context *context, const pc_mesh *surface,
                                   const pc_mesh *proxy, const pc_motion *motion, double reach,
                                   double *shares) {
    pci_scratch scratch = pci_scratch_begin(context);
    double *points = PCI_SCRATCH(&scratch, double, 3 * proxy->vertex_count);
    size_t count = 0;
    for (size_t v = 0; v < proxy->vertex_count && points != NULL; ++v) {
        if (motion->pinned[v]) {
            memcpy(&points[3 * count++], &proxy->positions[3 * v], 3 * sizeof(double));
        }
    }
    pci_knn knn;
    pc_status status = PC_OK;
    if (points == NULL || (count != 0 && !pci_knn_build(&scratch, count, points, &knn))) {
        status = pci_fail_memory(context, module);
    } else if (count == 0) {
        status = pci_fail(context, PC_ERROR_INVALID_OPTIONS, module,
                          "body: body_blend needs pinned vertices");
    }
    for (size_t v = 0; v < surface->vertex_count && status == PC_OK; ++v) {
        uint32_t nearest;
        double squared;
        pci_knn_query(&knn, &surface->positions[3 * v], 1, PC_INVALID_INDEX, &nearest, &squared);
        const double t = fmin(sqrt(squared) / reach, 1.0);
        shares[v] = t * t * (3.0 - 2.0 * t);
    }
    pci_scratch_end(&scratch);
    return status;
}

static pc_status share_by_color(pc_context *context, const pc_visual *visual, uint32_t channel,
                                double *shares) {
    if (visual->colors == NULL) {
        return pci_fail(context, PC_ERROR_INVALID_OPTIONS, module,
                        "body: body_channel is given, but the visual mesh has no vertex colors");
    }
    // Of the split vertices the first counts.
    for (size_t c = visual->corner_count; c-- > 0;) {
        const double value = (double)visual->colors[4 * c + channel];
        shares[visual->corner_vertices[c]] = fmin(fmax(value, 0.0), 1.0);
    }
    return PC_OK;
}

static pc_status fill(pc_context *context, const pc_visual *visual, const pc_character *character,
                      const pc_mesh *proxy, const pc_motion *motion, const pc_skin_options *options,
                      pc_body_skin *skin, pc_body_report *report) {
    const pc_mesh *surface = &visual->surface;
    skin->vertex_count = surface->vertex_count;
    skin->joints = PCI_ALLOCATE(context, uint32_t, 4 * surface->vertex_count);
    skin->weights = PCI_ALLOCATE(context, double, 4 * surface->vertex_count);
    skin->shares = PCI_ALLOCATE(context, double, surface->vertex_count);
    if (skin->joints == NULL || skin->weights == NULL || skin->shares == NULL) {
        return pci_fail_memory(context, module);
    }
    pc_status status = PC_OK;
    report->own_weights = own_weights(visual, skin);
    if (report->own_weights == 0 && pci_body_is_skinned(character)) {
        pci_transfer_counts counts;
        status = pci_transfer_weights(context, module, surface, character, skin->joints,
                                      skin->weights, &counts);
        report->matched = counts.matched;
        report->filled = counts.filled;
        report->rigid = counts.rigid;
    } else if (report->own_weights == 0) {
        status = pci_fail(context, PC_ERROR_INVALID_OPTIONS, module,
                          "body: neither the garment nor the body follows the skeleton of the "
                          "input");
    }
    if (status == PC_OK) {
        status = options->body_channel != PC_BODY_CHANNEL_NONE
                     ? share_by_color(context, visual, options->body_channel - 1, skin->shares)
                     : share_by_distance(context, surface, proxy, motion,
                                         options->body_blend * pci_diagonal(surface), skin->shares);
    }
    for (size_t v = 0; v < surface->vertex_count && status == PC_OK; ++v) {
        skin->shares[v] = skin->weights[4 * v] > 0.0 ? skin->shares[v] : 1.0;
    }
    return status;
}

pc_status pc_body_skin_create(pc_context *context, const pc_visual *visual,
                              const pc_character *character, const pc_mesh *proxy,
                              const pc_motion *motion, const pc_skin_options *options,
                              pc_body_skin *skin, pc_body_report *report) {
    static const pc_body_skin empty;
    if (visual == NULL || character == NULL || proxy == NULL || motion == NULL || skin == NULL ||
        memcmp(skin, &empty, sizeof(empty)) != 0 || motion->vertex_count != proxy->vertex_count) {
        return pci_fail(context, PC_ERROR_INVALID_ARGUMENT, module,
                        "body: an input is NULL or does not fit, or the output is not empty");
    }
    pc_skin_options chosen;
    pc_body_report counts = {0};
    pc_status status = pci_begin_stage(context, module, &pc_skin_options_record, options, &chosen);
    if (status == PC_OK &&
        (chosen.body_blend > 0.0 || chosen.body_channel != PC_BODY_CHANNEL_NONE)) {
        status = fill(context, visual, character, proxy, motion, &chosen, skin, &counts);
    }
    if (status != PC_OK) {
        pc_body_skin_free(context, skin);
    } else if (report != NULL) {
        *report = counts;
    }
    return status;
}
