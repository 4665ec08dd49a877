#include "stages/skin/skin_driver.h"

#include "geometry/topology.h"

double pci_skin_extent(const pci_skin_problem *problem, double origin[3]) {
    const pc_mesh points = {.vertex_count = problem->proxy_count,
                            .positions = (double *)problem->proxy_rest};
    double low[3], high[3];
    pci_bounding_box(&points, low, high);
    for (size_t c = 0; c < 3; ++c) {
        origin[c] = 0.5 * (low[c] + high[c]);
    }
    return sqrt(pci_squared_distance(low, high));
}

void pci_skin_point(const pci_skin_problem *problem, const double origin[3], double unit,
                    size_t vertex, double *point) {
    point[0] = 1.0;
    for (size_t c = 0; c < 3 && problem->rotations != NULL; ++c) {
        point[1 + c] = unit * (problem->rest[3 * vertex + c] - origin[c]);
    }
}

void pci_skin_turn_map(const pci_skin_problem *problem, const double origin[3], size_t frame,
                       size_t bone, double *map) {
    double arm[3], turn[9];
    pci_sub(&problem->proxy_rest[3 * bone], origin, arm);
    pci_matrix_of_quaternion(&problem->rotations[4 * (frame * problem->proxy_count + bone)], turn);
    for (size_t k = 0; k < 9; ++k) {
        const size_t row = k % 3, column = k / 3;
        map[3 + k] = turn[3 * row + column] - (row == column ? 1.0 : 0.0);
        map[row] -= map[3 + k] * arm[column];
    }
}
