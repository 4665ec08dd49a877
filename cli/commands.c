// The table of commands.
#include "cli.h"

#include <stdio.h>
#include <string.h>

enum { all_stages = (1u << PC_STAGE_COUNT) - 1 };

static const cli_command commands_before[] = {
    {.name = "build",
     .operands = "INPUT -o OUTDIR",
     .summary = "garment mesh -> proxy mesh, simulated frames and skinning weights",
     .details = "INPUT is an OBJ, FBX, glTF, GLB, DAE, PLY or STL file. Writes NAME.glb,\n"
                "NAME.proxy.obj, NAME.h5, NAME.json and NAME.png into OUTDIR, over older ones.\n"
                "Several levels of detail in one run: --vertices 64,128,512 writes NAME.lod64.glb\n"
                "and so on, each a proxy with motion and weights of its own.\n"
                "Several garments in one file: --parts separate writes NAME.part1.glb and so on,\n"
                "the largest first, and shares the vertices by area; linings, pockets and buttons\n"
                "stay with what they lie on.\n"
                "OBJ, PLY and STL files hold neither unit nor up axis and are taken as they are;\n"
                "see --up-axis. FBX and DAE files are converted to metres and y up.\n",
     .example = "jacket.fbx -o out --vertices 256",
     .minimum_inputs = 1,
     .maximum_inputs = 1,
     .accepts =
         CLI_OUTPUT_FOLDER | CLI_NAME | CLI_MESH | CLI_PNG | CLI_SCENARIO | CLI_PARTS | CLI_OPTIONS,
     .stages = all_stages,
     .run = cli_run_build},
    {.name = "batch",
     .operands = "IN... -o OUTDIR",
     .summary = "convert many garments, several at once",
     .details =
         "IN is a file, a folder, a glob or a manifest. Each garment gets a process of its own "
         "with\n"
         "limits of memory and time, and a folder OUTDIR/garments/ID that arrives complete. What\n"
         "is up to date, by the content of the input, the options and the version, is left alone:\n"
         "run the same command again to go on after an interruption. One line of JSON per garment\n"
         "is printed; OUTDIR/batch.json is written last. A manifest (*.jsonl) has lines such as\n"
         "{\"id\": \"cape\", \"path\": \"knight.glb\", \"mesh\": \"*Cape*\", \"options\": "
         "{\"vertices\": 64}}\n"
         "The cores are shared: with a garment per core each gets one thread.\n"
         "Exit code 1: garments failed; 75: another run may help some of them. Many machines\n"
         "share the work with --shard (on Slurm: data/batch.slurm); a run without it collects one\n"
         "report: seq 8 | parallel proxycloth batch IN -o OUTDIR --shard {}/8 --jobs 1\n",
     .example = "garments/ -o out --jobs 8",
     .minimum_inputs = 1,
     .maximum_inputs = SIZE_MAX,
     .accepts = CLI_OUTPUT_FOLDER | CLI_MESH | CLI_PNG | CLI_SCENARIO | CLI_PARTS | CLI_OPTIONS |
                CLI_BATCH,
     .stages = all_stages,
     .run = cli_run_batch},
};

static const cli_command commands_after[] = {
    {.name = "export",
     .operands = "ASSET -o OUTDIR",
     .summary = "finished asset file -> glb, proxy.obj, json and png",
     .example = "jacket.h5 -o out",
     .minimum_inputs = 1,
     .maximum_inputs = 1,
     .accepts = CLI_OUTPUT_FOLDER | CLI_NAME | CLI_PNG,
     .run = cli_run_export},
    {.name = "info",
     .operands = "FILE",
     .summary = "list what a mesh, scene or asset file holds",
     .example = "character.glb",
     .minimum_inputs = 1,
     .maximum_inputs = 1,
     .accepts = CLI_JSON | CLI_MESH,
     .run = cli_run_info},
    {.name = "evaluate",
     .operands = "VISUAL PROXY | --motion ASSET [WEIGHTS.glb]",
     .summary = "measure a proxy mesh against its visual mesh, or skinning weights on a motion",
     .details =
         "VISUAL and PROXY may be asset files: the visual mesh or the proxy is taken.\n"
         "--motion simulates the proxy of ASSET in another wind and compares its weights, those\n"
         "in WEIGHTS.glb (of any program; one joint where each proxy vertex rests), and weights\n"
         "without optimisation: inverse distance, closest triangle, the same smoothed. One row has\n"
         "the asset's weights on the motion that they were made for.\n",
     .example = "jacket.obj out/jacket.proxy.obj",
     .minimum_inputs = 1,
     .maximum_inputs = 2,
     .accepts = CLI_JSON | CLI_MESH | CLI_MOTION | CLI_SCENARIO,
     .run = cli_run_evaluate},
    {.name = "regress",
     .operands = "BASELINE [OUTDIR]",
     .summary = "tell which garments got worse than in a baseline",
     .details =
         "Compares the reports below OUTDIR, of batch or build, with those of BASELINE: a folder\n"
         "of the same kind, or a table. Prints every measure that got worse by more than its\n"
         "tolerance, and garments that are missing; exit code 1 then. Without OUTDIR the measures\n"
         "of BASELINE are printed as a table, to be kept as a baseline.\n"
         "--tolerances holds tolerances that differ from the usual ones, as in {\"hausdorff\":\n"
         "{\"absolute\": 0.01, \"relative\": 0.1}, \"min_angle_worst\": null}; null leaves a "
         "measure\n"
         "out.\n",
     .example = "baseline.tsv out",
     .minimum_inputs = 1,
     .maximum_inputs = 2,
     .accepts = CLI_REGRESS | CLI_JSON,
     .run = cli_run_regress},
    {.name = "report",
     .operands = "FOLDER [-o FILE.html]",
     .summary = "one HTML page over all results in a folder",
     .details =
         "Contact sheets by their worst measure, measures, histograms, times, warnings, failures\n"
         "and options of what build or batch wrote into FOLDER and the folders in it. The page\n"
         "needs no other file and no network; FOLDER/report.html also links to the results. With\n"
         "many garments it holds thumbnails.\n",
     .minimum_inputs = 1,
     .maximum_inputs = 1,
     .example = "out",
     .accepts = CLI_OUTPUT_PAGE,
     .run = cli_run_report},
    {.name = "help",
     .operands = "[COMMAND]",
     .summary = "explain a command and its options",
     .example = "build",
     .maximum_inputs = 1,
     .run = cli_run_help},
    {.name = "completion",
     .operands = "",
     .summary = "print a script that completes commands and options in bash",
     .details = "eval \"$(proxycloth completion)\" in ~/.bashrc, or save it to\n"
                "/etc/bash_completion.d/proxycloth.\n",
     .run = cli_run_completion},
    {.name = "version",
     .operands = "",
     .summary = "print the version, and with --licences those of all libraries",
     .accepts = CLI_LICENCES,
     .run = cli_run_version},
};

enum {
    before_count = sizeof(commands_before) / sizeof(commands_before[0]),
    after_count = sizeof(commands_after) / sizeof(commands_after[0])
};

static const char *const stage_examples[PC_STAGE_COUNT] = {
    [PC_STAGE_VOXELIZE] = "jacket.obj -o jacket.h5 --voxels 64",
    [PC_STAGE_ISOSURFACE] = "jacket.h5",
    [PC_STAGE_PROJECT] = "jacket.h5 --projection-solver cholesky",
    [PC_STAGE_GRAPH] = "jacket.h5 --tube-aspect 2",
    [PC_STAGE_LABEL] = "jacket.h5 --lambda-smooth 3 --write-lp jacket.lp",
    [PC_STAGE_CARVE] = "jacket.h5 --carve",
    [PC_STAGE_SIMPLIFY] = "jacket.h5 --vertices 64,128,512",
    [PC_STAGE_SIMULATE] = "jacket.h5 --scenario cape.json",
    [PC_STAGE_SKIN] = "jacket.h5 --influences 8",
};

static cli_command stage_command(pc_stage stage) {
    const pc_stage_info *info = pc_stage_describe(stage);
    cli_command command = {.name = info->name,
                           .operands = "ASSET [-o ASSET]",
                           .summary = info->summary,
                           .details = "Writes the result back into ASSET, or to the file behind "
                                      "-o. Results of later\nstages are dropped.\n",
                           .example = stage_examples[stage],
                           .minimum_inputs = 1,
                           .maximum_inputs = 1,
                           .accepts = CLI_OUTPUT_FILE | CLI_OPTIONS,
                           .stages = 1u << stage,
                           .stage = stage,
                           .run = cli_run_stage};
    if (stage == PC_STAGE_SIMPLIFY) {
        command.details = "Writes the result back into ASSET, or to the file behind -o. Results of "
                          "later\nstages are dropped. --vertices 64,128,512 writes one file per "
                          "level of detail,\nASSET.lod64.h5 and so on; ASSET stays as it is.\n";
    }
    if (stage == PC_STAGE_LABEL) {
        command.accepts |= CLI_WRITE_LP;
    }
    if (stage == PC_STAGE_VOXELIZE) {
        command.operands = "INPUT -o ASSET";
        command.details = "INPUT is a mesh or scene file, or an asset file whose visual mesh is "
                          "taken.\n";
        command.accepts |= CLI_NAME | CLI_MESH;
    } else if (stage == PC_STAGE_SIMULATE) {
        command.accepts |= CLI_SCENARIO;
    }
    return command;
}

bool cli_command_at(size_t index, cli_command *command) {
    if (index < before_count) {
        *command = commands_before[index];
    } else if (index < before_count + PC_STAGE_COUNT) {
        *command = stage_command((pc_stage)(index - before_count));
    } else if (index < before_count + PC_STAGE_COUNT + after_count) {
        *command = commands_after[index - before_count - PC_STAGE_COUNT];
    } else {
        return false;
    }
    return true;
}

bool cli_find_command(const char *name, cli_command *command) {
    for (size_t i = 0; cli_command_at(i, command); ++i) {
        if (strcmp(command->name, name) == 0) {
            return true;
        }
    }
    return false;
}
