// The headers compile as C++ and the library links from it.
#include <proxycloth/proxycloth.h>

int main() {
    pc_context *context = nullptr;
    const pc_options options = pc_default_options();
    const bool good =
        pc_context_create(nullptr, &context) == PC_OK && options.simplify.vertices == 128;
    pc_context_destroy(context);
    return good ? 0 : 1;
}
