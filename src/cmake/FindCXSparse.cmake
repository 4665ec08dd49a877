# SuiteSparse 5 ships neither a CMake package nor a .pc file. CXSparse has its own ordering and needs
# no other part of it.
find_path(CXSparse_INCLUDE_DIR cs.h PATH_SUFFIXES suitesparse)
find_library(CXSparse_LIBRARY cxsparse)
include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(CXSparse
  REQUIRED_VARS CXSparse_LIBRARY CXSparse_INCLUDE_DIR)
if(CXSparse_FOUND AND NOT TARGET CXSparse::CXSparse)
  add_library(CXSparse::CXSparse INTERFACE IMPORTED)
  set_target_properties(CXSparse::CXSparse PROPERTIES
    INTERFACE_INCLUDE_DIRECTORIES ${CXSparse_INCLUDE_DIR}
    INTERFACE_LINK_LIBRARIES "${CXSparse_LIBRARY}")
endif()
mark_as_advanced(CXSparse_INCLUDE_DIR CXSparse_LIBRARY)
