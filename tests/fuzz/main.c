/* One libFuzzer program for each target (the build sets FUZZ_TARGET). Run it with a corpus folder;
 * seeds and the kept corpus are first written into it: fuzz_spz corpus/spz -max_total_time=60
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

static void put(const char *dir, const char *kind, size_t i, const struct buf *b)
{
    char path[FILE_PATH_MAX];
    snprintf(path, sizeof path, "%s/%s-%zu", dir, kind, i);
    if (file_write(path, b->data, b->size, NULL) != ERR_OK)
        fprintf(stderr, "%s: cannot be written\n", path);
}

/* Seeds, and the corpus if this runs in the source folder, into every folder that is named. */
int LLVMFuzzerInitialize(int *argc, char ***argv)
{
    for (int a = 1; a < *argc; a++) {
        const char *dir = (*argv)[a];
        struct buf b = {0}, corpus = {0};
        if (!file_is_dir(dir))
            continue;
        for (size_t i = 0; i < FUZZ_SEEDS; i++) {
            if (fuzz_seed(TEXT(FUZZ_TARGET), i, &b))
                put(dir, "seed", i, &b);
            buf_free(&b);
        }
        if (file_read("tests/fuzz/corpus/" TEXT(FUZZ_TARGET) ".txt", 0, &corpus, NULL) == ERR_OK)
            for (size_t i = 0, at = 0; at < corpus.size; i++) {
                at = fuzz_corpus_line(&corpus, at, &b);
                put(dir, "kept", i, &b);
            }
        buf_free(&b);
        buf_free(&corpus);
    }
    return 0;
}
