# Language level, warnings, floating-point rules and sanitizers that all our targets share.
function(proxycloth_target target)
  set_target_properties(${target} PROPERTIES
    C_STANDARD 17 C_STANDARD_REQUIRED ON C_EXTENSIONS OFF
    C_VISIBILITY_PRESET hidden POSITION_INDEPENDENT_CODE ON)
  # No fused multiply-adds behind our back: results must not depend on the compiler's mood.
  target_compile_options(${target} PRIVATE
    -ffp-contract=off -fno-math-errno
    -Wall -Wextra -Wpedantic -Wshadow -Wconversion -Wsign-conversion
    $<$<C_COMPILER_ID:GNU>:-Wdouble-promotion> # clang's also warns of the macros INFINITY and NAN
    -Wstrict-prototypes -Wmissing-prototypes -Wvla -Wundef)
  if(PROXYCLOTH_SANITIZE)
    target_compile_options(${target} PRIVATE
      -fsanitize=${PROXYCLOTH_SANITIZE} -fno-sanitize-recover=all -fno-omit-frame-pointer -g)
    target_link_options(${target} PUBLIC -fsanitize=${PROXYCLOTH_SANITIZE})
  endif()
endfunction()
