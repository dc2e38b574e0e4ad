/* front_city OUT.tiles [GAUSSIANS]: a small city for tests of programs in front of the server.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/served.h"

#include <stdlib.h>

int main(int argc, char **argv)
{
    const long n = argc == 3 ? strtol(argv[2], NULL, 10) : 2000;
    if (argc < 2 || argc > 3 || n < 1 || n > 1000000)
        return 2;
    served_city(argv[1], "toy", (size_t)n);
    return 0;
}
