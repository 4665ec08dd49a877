# Install rules: library, headers, program, CMake package and pkg-config file.
include(CMakePackageConfigHelpers)

set(package_dir ${CMAKE_INSTALL_LIBDIR}/cmake/proxycloth)
install(TARGETS proxycloth EXPORT proxycloth-targets
  ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR}
  FILE_SET HEADERS DESTINATION ${CMAKE_INSTALL_INCLUDEDIR})
install(EXPORT proxycloth-targets NAMESPACE proxycloth:: DESTINATION ${package_dir})
configure_package_config_file(src/cmake/proxycloth-config.cmake.in
  ${PROJECT_BINARY_DIR}/proxycloth-config.cmake INSTALL_DESTINATION ${package_dir})
write_basic_package_version_file(${PROJECT_BINARY_DIR}/proxycloth-config-version.cmake
  COMPATIBILITY SameMinorVersion)
install(FILES ${PROJECT_BINARY_DIR}/proxycloth-config.cmake
  ${PROJECT_BINARY_DIR}/proxycloth-config-version.cmake src/cmake/FindCXSparse.cmake
  DESTINATION ${package_dir})

# The library is static, so its dependencies belong to Libs. HDF5 by the library that was found: its
# .pc file follows a Debian alternative that may be another build.
list(GET HDF5_C_LIBRARIES 0 hdf5_library)
file(RELATIVE_PATH pc_prefix /prefix/${CMAKE_INSTALL_LIBDIR}/pkgconfig /prefix)
configure_file(src/cmake/proxycloth.pc.in proxycloth.pc @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/proxycloth.pc DESTINATION ${CMAKE_INSTALL_LIBDIR}/pkgconfig)

if(TARGET proxycloth_cli)
  install(TARGETS proxycloth_cli RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
endif()
