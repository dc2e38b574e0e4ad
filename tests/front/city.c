/* front_city OUT.tiles: a small city for tests of programs in front of the server.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/served.h"

int main(int argc, char **argv)
{
    if (argc != 2)
        return 2;
    served_city(argv[1], "toy", 2000);
    return 0;
}
