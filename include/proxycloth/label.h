/// Stage 5 of 9, label: guide graph -> one label per vertex, with a certificate.
///
/// Minimises equations (2) and (3) over l in {0, 1}^V:
///   lambda_s sum_E w_ij [l_i != l_j]
///   + lambda_o sum_Eo ([l_i == l_j] + lambda_bias [s_ij != 0 and l_i - l_j != s_ij]).
/// The problem is not submodular. Weights become integers, so that all proofs are exact. Then
///   1. roof duality (maximum flow on the doubled graph) fixes most labels and proves a bound,
///   2. the rest splits into components; variable elimination solves those of small width,
///   3. the others get labels by annealing and by rounding, and a bound by packing cycles whose
///      wishes contradict each other (the dual of the relaxation with odd-cycle inequalities),
///   4. edges whose violation would cost more than the gap are contracted, and what is left starts
///      again at 1.
///
/// Postconditions: `objective` is the value of `labels`; no labelling has a value below `bound`.
/// Not reaching the optimum is no error: see `outcome` and `gap`. Work is counted, never timed, so
/// the result is reproducible. A connected part of the graph in which no vertex prefers a label has
/// two mirrored optima; its lowest vertex gets label 1.
#ifndef PROXYCLOTH_LABEL_H
#define PROXYCLOTH_LABEL_H

#include "proxycloth/graph.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef enum pc_label_outcome {
    PC_LABEL_OPTIMAL = 0, ///< gap at most 1e-6 of the objective
    PC_LABEL_FEASIBLE = 1 ///< the work budget ended first
} pc_label_outcome;

typedef struct pc_labels {
    size_t vertex_count;
    uint8_t *labels; ///< #V, 1 on the layer that is kept
} pc_labels;

/// Releases the arrays and zeroes the struct. NULL is accepted.
void pc_labels_free(pc_context *context, pc_labels *labels);

typedef struct pc_label_options {
    double lambda_smooth;   ///< lambda_s
    double lambda_opposite; ///< lambda_o
    double lambda_bias;
    uint32_t label_effort; ///< work budget for packing (steps 3 and 4); 0 leaves it out
    /// Time limit for packing, looked at between its rounds, so that a call may last a little
    /// longer. 0: none. Results under a limit are not reproducible.
    double label_seconds;
} pc_label_options;

typedef struct pc_label_report {
    uint32_t outcome; ///< pc_label_outcome
    double objective;
    double bound;      ///< proven lower bound
    double gap;        ///< (objective - bound) / max(1, |objective|)
    double roof_bound; ///< bound of roof duality alone
    uint64_t fixed;    ///< labels proven by roof duality
    uint64_t residual; ///< labels left after it
    uint64_t residual_components;
    uint64_t unproven_components; ///< components that ended without proof
} pc_label_report;

extern const pc_record pc_label_options_record;
extern const pc_record pc_label_report_record;

/// @param[in]  graph   curvatures and outer_distances are not read.
/// @param[out] labels  zeroed on entry.
/// @return PC_OK (also without proof); PC_ERROR_INVALID_ARGUMENT (index out of range, edge from a
///         vertex to itself, weight or sum of weights not finite, negative weight, sign not in
///         -1..1); PC_ERROR_INVALID_OPTIONS; PC_ERROR_TOO_LARGE; PC_ERROR_OUT_OF_MEMORY;
///         PC_ERROR_CANCELLED.
PC_NODISCARD pc_status pc_label(pc_context *context, const pc_graph *graph,
                                const pc_label_options *options, pc_labels *labels,
                                pc_label_report *report);

/// Value of a labelling, recomputed from the definition; the caller vouches for the indices.
/// @param[in] options  not NULL.
/// @param[in] labels   one per vertex of the graph.
double pc_label_objective(const pc_graph *graph, const pc_label_options *options,
                          const uint8_t *labels);

/// Writes the integer program, equations (2) to (5), in CPLEX LP format. Variables: l0, l1, ... are
/// the labels; sE_xy and oE_xy are 1 where mesh edge or opposite edge E has labels (x, y). There is
/// no constant term: the optimum is the least objective of pc_label.
/// @param[in] options  weights; NULL for the defaults.
/// @return PC_OK; PC_ERROR_INVALID_ARGUMENT (as pc_label; NULL); PC_ERROR_INVALID_OPTIONS;
///         PC_ERROR_TOO_LARGE; PC_ERROR_IO; PC_ERROR_OUT_OF_MEMORY.
PC_NODISCARD pc_status pc_label_write_lp(pc_context *context, const pc_graph *graph,
                                         const pc_label_options *options, const char *path);

#ifdef __cplusplus
}
#endif
#endif
