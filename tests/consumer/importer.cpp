// The importer of importer.c in C++: an asset file is loaded, stepped and deformed every frame,
// with owners that clean up, and an allocator, a log and a progress callback of the engine's.
//
//     importer ASSET.h5
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <stdexcept>
#include <string>
#include <vector>

#include <proxycloth/proxycloth.h>

namespace {

// Engines count what they give away.
struct Engine {
    long live = 0;
    static void *allocate(void *user, size_t size) {
        ++static_cast<Engine *>(user)->live;
        return std::malloc(size);
    }
    static void release(void *user, void *memory) {
        --static_cast<Engine *>(user)->live;
        std::free(memory);
    }
};

struct Vertex {
    float position[3], normal[3], texture[2];
};

class Garment {
  public:
    Garment(pc_context *context, const char *path) : context_(context) {
        check(pc_asset_load(context, path, &asset_));
        const pc_simulate_inputs inputs = {&asset_.proxy, &asset_.scenario, &asset_.visual,
                                           &asset_.character};
        check(pc_simulator_create(context, &inputs, &asset_.options.simulate, &simulator_));
        check(pc_deform_prepare_asset(context, &asset_, &deformer_));
        joints_.resize(3 * asset_.proxy.vertex_count);
        vertices_.resize(pc_deform_vertex_count(deformer_));
        pose_.resize(pc_deform_pose_size(deformer_));
    }
    ~Garment() { free(); }
    Garment(const Garment &) = delete;
    Garment &operator=(const Garment &) = delete;

    size_t frames() const { return asset_.motion.frame_count; }

    const std::vector<Vertex> &next_frame() {
        for (uint32_t i = 0; i < asset_.options.simulate.frame_steps; ++i) {
            check(pc_simulator_step(simulator_, nullptr, nullptr));
        }
        const double *positions = pc_simulator_positions(simulator_);
        for (size_t k = 0; k < joints_.size(); ++k) {
            joints_[k] = static_cast<float>(positions[k]);
        }
        pc_deform_input input = {};
        input.joints = joints_.data();
        pc_deform_pose(deformer_, &input, pose_.data());
        const pc_deform_output output = {vertices_[0].position, sizeof(Vertex), vertices_[0].normal,
                                         sizeof(Vertex)};
        pc_deform(deformer_, pose_.data(), 0, vertices_.size(), &output);
        return vertices_;
    }

    // How far the last frame is from the one in the file, over the size of the garment.
    double difference() const {
        const double *wanted = &asset_.motion.positions[joints_.size() * (frames() - 1)];
        double largest = 0.0;
        for (size_t k = 0; k < joints_.size(); ++k) {
            largest = std::fmax(largest, std::fabs(wanted[k] - static_cast<double>(joints_[k])));
        }
        return largest / asset_.reports.visual.diagonal;
    }

  private:
    void check(pc_status status) {
        if (status != PC_OK) {
            const std::string message = pc_context_error(context_)->message;
            free();
            throw std::runtime_error(message);
        }
    }
    void free() {
        pc_simulator_destroy(simulator_);
        pc_deform_destroy(context_, deformer_);
        pc_asset_free(context_, &asset_);
        simulator_ = nullptr;
        deformer_ = nullptr;
    }

    pc_context *context_;
    pc_asset asset_ = {};
    pc_simulator *simulator_ = nullptr;
    pc_deformer *deformer_ = nullptr;
    std::vector<float> joints_;
    std::vector<Vertex> vertices_;
    std::vector<unsigned char> pose_;
};

int play(pc_context *context, const char *path) {
    Garment garment(context, path);
    double length = 0.0;
    for (size_t frame = 0; frame < garment.frames(); ++frame) {
        const float *normal = garment.next_frame()[0].normal;
        length = std::sqrt(static_cast<double>(normal[0] * normal[0] + normal[1] * normal[1] +
                                               normal[2] * normal[2]));
    }
    std::printf("%zu frames, difference %.1e, normal of length %.6f\n", garment.frames(),
                garment.difference(), length);
    return garment.difference() < 1e-6 && std::fabs(length - 1.0) < 1e-5 ? 0 : 1;
}

} // namespace

int main(int argument_count, char **arguments) {
    Engine engine;
    pc_context_options options = {};
    options.allocator = {Engine::allocate, Engine::release, &engine};
    options.log = [](void *, pc_log_level, const char *stage, const char *message) {
        std::fprintf(stderr, "%s: %s\n", stage, message);
    };
    options.progress = [](void *, const char *, double) { return true; };
    pc_context *context = nullptr;
    if (argument_count != 2 || pc_context_create(&options, &context) != PC_OK) {
        return 2;
    }
    int result = 1;
    try {
        result = play(context, arguments[1]);
    } catch (const std::exception &error) {
        std::fprintf(stderr, "importer: %s\n", error.what());
    }
    pc_context_destroy(context);
    return engine.live == 0 ? result : 1;
}
