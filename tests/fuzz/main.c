/* One libFuzzer program for each target (the build sets FUZZ_TARGET). Run it with a corpus folder;
 * an empty one is first filled with the seeds: fuzz_spz corpus/spz -max_total_time=60
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <stdio.h>

#include "tests/fuzz/fuzz.h"

#define PASTE2(a, b) a##b
#define PASTE(a, b) PASTE2(a, b)
#define TEXT2(a) #a
#define TEXT(a) TEXT2(a)

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);
int LLVMFuzzerInitialize(int *argc, char ***argv);

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    PASTE(fuzz_, FUZZ_TARGET)(bytes, n);
    return 0;
}

/* Seeds into every folder named on the command line. */
int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    for (int a = 1; a < *argc; a++) {
        const char *dir = (*argv)[a];
        for (size_t i = 0; file_is_dir(dir) && i < FUZZ_SEEDS; i++) {
            char path[FILE_PATH_MAX];
            struct buf b = {0};
            snprintf(path, sizeof path, "%s/seed-%zu", dir, i);
            if (fuzz_seed(TEXT(FUZZ_TARGET), i, &b) &&
                file_write(path, b.data, b.size, NULL) != ERR_OK)
                fprintf(stderr, "%s: cannot write seed\n", path);
            buf_free(&b);
        }
    }
    return 0;
}
